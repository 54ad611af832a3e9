# SPDX-License-Identifier: Apache-2.0
"""How well build-map measures misfits: RedKitchen's model is moved by known similarities.

    GSCPE_DATA=DATA .venv/bin/python tools/bench_misfit.py

prints the table of docs/building-maps.md. DATA/redkitchen holds splat.ply, the COLMAP model
sparse/0 and the photos in references/.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import MapError
from gscpe.geometry import se3
from gscpe.geometry.pose_error import camera_centres
from gscpe.geometry.similarity_transform import Similarity
from gscpe.mapping import FrameCheckSettings, measure_misfit
from gscpe.mapping.frame_candidates import nerfstudio_normalization
from gscpe.scene import References
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.moved import move_references, move_scene
from gscpe.splats import GaussianScene, read_splat

_HEADER = "| model moved by | | scale (true) | cameras away | turned | left after the fit |"


def main() -> None:
    data = Path(os.environ["GSCPE_DATA"]) / "redkitchen"
    scene = read_splat(data / "splat.ply")
    references = read_colmap_references(data / "sparse" / "0", data / "references")
    centres = camera_centres(references.cam_from_world)
    middle = centres.mean(axis=0)

    def about(scale: float = 1.0, degrees: float = 0.0, aside: float = 0.0) -> Similarity:
        turn = se3.exp([0, 0, 0, *np.radians(degrees) * np.array([0.3, 0.93, 0.2])])[:3, :3]
        shift = np.array([aside, 0, 0])
        return Similarity(scale, turn, middle - scale * turn @ middle + shift)

    def report(
        name: str,
        moved: Similarity,
        poses: References,
        splat: GaussianScene,
        true_centres: Float64Array,
    ) -> None:
        """``moved`` is what splat_from_model must undo; the centres are in the splat."""
        try:
            misfit = measure_misfit(splat, poses, data / "references")
        except MapError as error:
            print(f"| {name} | {error} | | | | |")
            return
        left = misfit.splat_from_model @ moved
        off = np.linalg.norm(left.apply(true_centres) - true_centres, axis=1).mean()
        print(
            f"| {name} | {misfit.verdict(FrameCheckSettings())} "
            f"| {misfit.splat_from_model.scale:.4f} ({1.0 / moved.scale:.4f}) "
            f"| {100 * misfit.shift:.2f} cm | {misfit.degrees:.2f}° "
            f"| {100 * off:.2f} cm, {left.degrees:.3f}° |",
            flush=True,
        )

    moves = {
        "nothing": about(),
        "2 cm": about(aside=0.02),
        "5 cm": about(aside=0.05),
        "20 cm": about(aside=0.2),
        "1 degree": about(degrees=1.0),
        "scale 1.03": about(1.03),
        "scale 1.1": about(1.1),
        "scale 1.3": about(1.3),
        "1 m and 10 degrees": about(1.0, 10.0, 1.0),
        "a half turn about x": Similarity(1.0, np.diag([1.0, -1.0, -1.0]), np.zeros(3)),
    }
    print(f"{_HEADER}\n|---|---|---|---|---|---|")
    for name, moved in moves.items():
        report(name, moved, move_references(references, moved), scene, centres)
    normalization = nerfstudio_normalization(references, Similarity.identity())
    report(
        "nothing, the splat by nerfstudio",
        normalization.inverse(),
        references,
        move_scene(scene, normalization),
        normalization.apply(centres),
    )


if __name__ == "__main__":
    main()
