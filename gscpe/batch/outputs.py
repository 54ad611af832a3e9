"""The files that come of a list: whether they can be written, and the pose files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping, Sequence

from gscpe.errors import OutputError
from gscpe.scene.photo_name import quoted_name


def check_outputs(paths: Sequence[str | Path | None], inputs: Sequence[str | Path] = ()) -> None:
    """Raises OutputError, before any long work, when one of the files cannot be written, is
    one of the inputs, or comes twice."""
    taken = {Path(path).resolve() for path in inputs}
    for path in (Path(path) for path in paths if path is not None):
        if path.resolve() in taken:
            raise OutputError(f"{path} is given twice; each input and output needs its own file")
        taken.add(path.resolve())
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            new = not path.exists()
            with path.open("a"):
                pass
            if new:  # nothing empty is left behind where the work fails
                path.unlink()
        except OSError as error:
            raise OutputError(f"{path} cannot be written: {error.strerror}") from error


def write_poses(details: Sequence[Mapping[str, Any]], path: str | Path, stage: str) -> None:
    """Writes hloc's pose file with the localized photos' poses of a stage.

    Args:
        details: of :func:`gscpe.batch.localize_list`; the file has their order.
        path: of the pose file.
        stage: ``"final"``; or that of one stage alone, ``"coarse"`` or ``"aligned"``.

    Raises:
        OutputError: the file cannot be written.
    """
    lines = []
    for detail in details:
        source = detail if stage == "final" else detail[stage]
        if detail["status"] == "localized" and source is not None:
            lines.append(f"{quoted_name(str(detail['name']))} {source['cam_from_world']}\n")
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_text("".join(lines), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from error
