# SPDX-License-Identifier: Apache-2.0
"""Photos or a video in, a map out."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Mapping, Sequence

import numpy as np

from gscpe.arrays import Float32Array
from gscpe.errors import OutputError, SettingsError
from gscpe.given import real_path
from gscpe.making.certificate import Certificate, write_certificate
from gscpe.making.certificate_page import write_certificate_page
from gscpe.making.certify import certify
from gscpe.making.settings import MakeMapSettings
from gscpe.mapping import MapSettings, build_map
from gscpe.photos.masks import check_masks
from gscpe.reconstruction import (
    KnownPoses,
    PoseRefinementSettings,
    Reconstruction,
    ScaleSource,
    not_kept_if_refused,
    open_work_folder,
    reconstruct,
    refine_known_poses,
)
from gscpe.reconstruction.disk import when_full
from gscpe.reconstruction.known_poses import fingerprint, known_model
from gscpe.retrieval import check_method
from gscpe.scene import References, open_map, save_map
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.map_folder import CERTIFICATE_PAGE, check_map_output
from gscpe.splats import read_splat

if TYPE_CHECKING:  # importing it needs Numba
    from gscpe.training import TrainingSettings

_SPLAT = "splat.ply"
_FRAME = "splat.frame"
_FINISHED = "finished"


@dataclass(frozen=True)
class MadeMap:
    """What came of it.

    Attributes:
        folder: of the map.
        gaussians, references: how many it has.
        reconstruction: of the photos; None where their poses were known.
        certificate: None where no photo was left out.
        page: the certificate for people; None without.
    """

    folder: Path
    gaussians: int
    references: int
    reconstruction: Reconstruction | None
    certificate: Certificate | None
    page: Path | None


def work_folder_of(output: str | Path) -> Path:
    """What is not finished yet lies beside the map."""
    output = Path(output).absolute()
    return output.with_name(output.name + ".work")


def make_map(
    source: str | Path | Sequence[str | Path] | KnownPoses,
    output: str | Path,
    settings: MakeMapSettings | None = None,
    scale: ScaleSource | None = None,
    masks: str | Path | None = None,
    *,
    resume: bool = False,
    backend: str = "auto",
    progress: bool = False,
    reconstructed: Callable[[Reconstruction], None] | None = None,
    refinement: PoseRefinementSettings | None = None,
) -> MadeMap:
    """A map of photos or videos: structure from motion, training, and the map's certificate.

    All steps leave what they made in a folder beside the output, ``OUTPUT.work``; after Ctrl-C, a
    crash or a full disk, ``resume`` goes on there. It may be deleted once the map is made; the
    model (``model/sparse/0``), its photos and the splat (``splat.ply``) are in it.

    Args:
        source: as of :func:`gscpe.reconstruct`; or photos with known poses.
        output: the map's folder.
        settings: how.
        scale: where the unit comes from; by default it stays unknown.
        masks: folder of pictures named like the photos, black where these do not count.
        resume: go on where a run was interrupted.
        backend: that the certificate's photos are localized with, see :class:`gscpe.Renderer`.
        progress: show bars.
        reconstructed: is told, before the long training, which photos were placed.
        refinement: how known poses are refined; None: they are taken as they are.

    Raises:
        ReconstructionError: as :func:`gscpe.reconstruct`, :func:`gscpe.refine_known_poses`.
        ColmapModelError: a known model cannot be read, is of other photos, or has no points
            and none can be triangulated.
        TrainingError: too few photos have a pose.
        PhotoError, CameraError: a photo or a mask cannot be used.
        OutputError: something cannot be written; another run is in the way.
        SettingsError, ModelError, MissingDependencyError: of the retrieval method, pycolmap, Numba.
    """
    settings, scale = settings or MakeMapSettings(), scale or ScaleSource()
    from gscpe.training import split_references

    training = _training_settings(settings)  # before any work: it needs Numba
    if isinstance(source, KnownPoses) and scale.kind != "unknown":
        raise SettingsError("known poses have a scale: give metres_per_unit, and no other scale")
    check_method(settings.retrieval)
    check_map_output(output)
    output, work = Path(output).absolute(), work_folder_of(output)
    open_work_folder(work, _stamp(source, settings, masks, refinement), resume, _FINISHED)
    with not_kept_if_refused(work):
        placed = _placed(source, work, settings, scale, refinement, masks, progress)
    if placed.reconstruction is not None and reconstructed is not None:
        reconstructed(placed.reconstruction)
    references = read_colmap_references(placed.model, placed.images)
    if masks is not None and placed.reconstruction is None:
        check_masks(Path(masks), list(references.names))
    learned, left_out = split_references(references, settings.test_every)
    splat = work / _SPLAT
    _check_frame(splat, learned)
    if not (splat.exists() and resume):
        max_size = settings.reconstruction.max_size
        _train(learned, placed, splat, training, max_size, masks, progress)
    scene = read_splat(splat)
    kept = MapSettings(settings.retrieval, placed.metres_per_unit)
    save_map(build_map(scene, learned, placed.images, kept, progress=progress), output)
    certificate = page = None
    if len(left_out):
        certificate, pictures = certify(
            *(open_map(output), left_out, placed.images, settings.certificate, backend),
            progress=progress,
        )
        page = _write_both(output, certificate, pictures, placed.reconstruction)
    (work / _FINISHED).touch()
    return MadeMap(output, len(scene), len(learned), placed.reconstruction, certificate, page)


@dataclass(frozen=True)
class _Placed:
    """Photos whose poses are known by now.

    Attributes:
        model: COLMAP model of them.
        images: folder of the photos.
        metres_per_unit: of the model; None where it is not known.
        reconstruction: what found or refined the poses; None where they were taken as they are.
    """

    model: Path
    images: Path
    metres_per_unit: float | None
    reconstruction: Reconstruction | None


def _placed(
    source: str | Path | Sequence[str | Path] | KnownPoses,
    work: Path,
    settings: MakeMapSettings,
    scale: ScaleSource,
    refinement: PoseRefinementSettings | None,
    masks: str | Path | None,
    progress: bool,
) -> _Placed:
    """Poses are found, refined, or taken as they are; what is in the folder is gone on with."""
    folder, how = work / "model", settings.reconstruction
    going_on = folder.exists()
    if not isinstance(source, KnownPoses):
        done = reconstruct(source, folder, how, scale, masks, resume=going_on, progress=progress)
    elif refinement is not None:
        done = refine_known_poses(
            source, folder, how, refinement, masks, resume=going_on, progress=progress
        )
    else:
        model = known_model(source, work)
        return _Placed(model, source.image_folder, source.metres_per_unit, None)
    return _Placed(done.model_folder, done.image_folder, done.frame.metres_per_unit, done)


def _write_both(
    output: Path,
    certificate: Certificate,
    pictures: Mapping[str, tuple[Float32Array, Float32Array]],
    reconstruction: Reconstruction | None,
) -> Path:
    """The certificate, and the page for people, into the map's folder."""
    page = output / CERTIFICATE_PAGE
    facts = {"structure from motion": str(reconstruction)} if reconstruction else {}
    write_certificate_page(page, output.name, certificate, pictures, facts)
    write_certificate(output, certificate)
    return page


def _training_settings(settings: MakeMapSettings) -> TrainingSettings:
    from gscpe.training import TrainingSettings

    return TrainingSettings(
        iterations=(
            TrainingSettings.iterations if settings.iterations is None else settings.iterations
        ),
        minutes=settings.minutes if settings.iterations is None else None,
        max_gaussians=settings.max_gaussians,
        seed=settings.seed,
    )


def _check_frame(splat: Path, learned: References) -> None:
    """Raises OutputError where a training that is to be gone on with was in another frame; keeps,
    for the next time, in which one this is."""
    from gscpe.training import checkpoint_of

    digest = hashlib.sha256("\n".join(learned.names).encode())
    digest.update(np.ascontiguousarray(learned.cam_from_world).tobytes())
    mark, kept = digest.hexdigest(), splat.with_name(_FRAME)
    begun = next((path for path in (splat, checkpoint_of(splat)) if path.exists()), None)
    if begun is not None and kept.exists() and kept.read_text(encoding="utf-8") != mark:
        raise OutputError(
            f"{begun} was trained on other photos, or in another unit or frame: give the same "
            "--test-every and --scale-from as then, or delete it, and with --resume only the "
            "training is done again"
        )
    with when_full(kept):
        kept.write_text(mark, encoding="utf-8")


def _train(
    learned: References,
    placed: _Placed,
    splat: Path,
    settings: TrainingSettings,
    max_size: int,
    masks: str | Path | None,
    progress: bool,
) -> None:
    """Writes the splat; where a checkpoint is beside it, from there."""
    from contextlib import closing, nullcontext

    from gscpe.training import (
        ProgressBar,
        checkpoint_of,
        train_references,
    )

    resume = checkpoint_of(splat).exists()
    with closing(ProgressBar()) if progress else nullcontext() as bar:
        train_references(
            *(learned, placed.model, placed.images, splat, settings, max_size, masks),
            resume=resume,
            progress=bar,
        )


def _stamp(
    source: str | Path | Sequence[str | Path] | KnownPoses,
    settings: MakeMapSettings,
    masks: str | Path | None,
    refinement: PoseRefinementSettings | None,
) -> dict[str, Any]:
    """What cannot be changed on the way. Photos and how they are put together are looked at by
    :func:`gscpe.reconstruct`, the frame and which photos are left out by :func:`_check_frame`; the
    minutes may be prolonged."""
    stamp: dict[str, Any] = {
        "iterations": settings.iterations,
        "max_gaussians": settings.max_gaussians,
        "seed": settings.seed,
        "masks": None if masks is None else str(real_path(masks)),
        "reconstruction": asdict(settings.reconstruction),
    }
    if isinstance(source, KnownPoses):
        stamp["photos"] = str(real_path(source.image_folder))
        stamp["poses"] = fingerprint(source)
        stamp["refinement"] = None if refinement is None else asdict(refinement)
    return stamp
