# SPDX-License-Identifier: Apache-2.0
"""Asks a service (``gscpe serve``) from Python."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Mapping
from urllib.parse import quote

from gscpe import errors
from gscpe.closing import Closing
from gscpe.errors import GscpeError, InputError, MissingDependencyError, ServiceError
from gscpe.geometry.camera import Camera
from gscpe.localization import PosePrior
from gscpe.photos.image_file import photo_bytes
from gscpe.poses.hloc import format_pose


class Client(Closing):
    """A connection to a service; threads may share it.

    Args:
        url: of the service, as ``http://127.0.0.1:8000``.
        token: that it asks for, or None.
        timeout: seconds that an answer may take.
        patience: seconds for which a service that is busy is asked again.

    Raises:
        MissingDependencyError: httpx is not installed.
        InputError: the address is none.
    """

    def __init__(
        self,
        url: str,
        token: str | None = None,
        timeout: float = 300.0,
        patience: float = 60.0,
    ) -> None:
        try:
            import httpx
        except ImportError as error:
            raise MissingDependencyError(
                f"gscpe.Client needs httpx ({error}): pip install 'gscpe[serve]'"
            ) from error
        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        limits = httpx.Limits(max_connections=None)
        try:
            self._http = httpx.Client(base_url=url, headers=headers, timeout=timeout, limits=limits)
        except (ValueError, TypeError, httpx.InvalidURL) as error:
            raise InputError(f"{url} is not the address of a service: {error}") from None
        self._patience = patience

    def maps(self) -> list[dict[str, Any]]:
        """The service's maps: name, Gaussians, reference photos.

        Raises:
            ServiceError: it cannot be reached, or failed.
        """
        found: list[dict[str, Any]] = self._ask("GET", "/v1/maps")
        return found

    def localize(
        self,
        map_: str | None,
        photo: str | Path | bytes,
        camera: Camera | str | None = None,
        prior: PosePrior | None = None,
    ) -> dict[str, Any]:
        """Where a photo was taken: what ``gscpe localize --json`` prints (docs/formats.md).

        Args:
            map_: the name of a map; None: all, and ``map_name`` of the answer says which.
            photo: path of an image file, or its bytes.
            camera: or its text, or None: the focal length is estimated.
            prior: approximate pose.

        Raises:
            PhotoError, CameraError, PoseError: the service cannot use what was sent.
            ServiceError: it cannot be reached, has no such map, is busy, or failed.
        """
        data, name = (photo, "photo") if isinstance(photo, bytes) else _named(photo)
        form = {}
        if camera is not None:
            form["camera"] = camera if isinstance(camera, str) else camera.colmap_text()
        if prior is not None:
            form["prior"] = format_pose(prior.cam_from_world)
            form["prior_sigma"] = f"{prior.translation_sigma} {prior.rotation_sigma_degrees}"
        files = {"photo": (name, data, "application/octet-stream")}
        address = "/v1/localize" if map_ is None else f"/v1/maps/{quote(map_, safe='')}/localize"
        answer: dict[str, Any] = self._ask("POST", address, data=form, files=files)
        return answer

    def _ask(self, method: str, path: str, **content: Any) -> Any:
        import httpx

        end = time.monotonic() + self._patience
        while True:
            try:
                answer = self._http.request(method, path, **content)
                found = answer.json()
            except httpx.TransportError as error:
                raise ServiceError(
                    f"the service at {self._http.base_url} cannot be reached: {error}"
                ) from error
            except ValueError:
                raise ServiceError(
                    f"{self._http.base_url} did not answer as a gscpe service does "
                    f"(status {answer.status_code})"
                ) from None
            if answer.is_success:
                return found
            wait = _seconds(answer.headers.get("Retry-After"))
            if answer.status_code != 503 or time.monotonic() + wait > end:
                raise _error(found, answer.status_code)
            time.sleep(wait)

    def close(self) -> None:
        """Closes its connections."""
        self._http.close()


def _named(photo: str | Path) -> tuple[bytes, str]:
    return photo_bytes(photo), Path(photo).name


def _seconds(header: str | None) -> float:
    return float(header) if header is not None and header.isdecimal() else 1.0


def _error(problem: Mapping[str, Any], status: int) -> GscpeError:
    """The typed error that a problem names."""
    kind = getattr(errors, str(problem.get("error")), None)
    detail = str(problem.get("detail", f"status {status}"))
    if isinstance(kind, type) and issubclass(kind, InputError):
        return kind(detail)
    return ServiceError(detail)
