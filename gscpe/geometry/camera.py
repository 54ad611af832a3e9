# SPDX-License-Identifier: Apache-2.0
"""Camera intrinsics in COLMAP's pixel convention, and the COLMAP camera models."""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Integral
from typing import Sequence

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import CameraError
from gscpe.geometry.information import is_covariance

# COLMAP model -> names of its parameters, in COLMAP's order. All but the fisheyes are special
# cases of OpenCV's rational model, those of THIN_PRISM_FISHEYE.
_MODEL_PARAMETERS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
_FISHEYE_PARAMETERS = {
    "SIMPLE_FISHEYE": ("f", "cx", "cy"),
    "FISHEYE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "THIN_PRISM_FISHEYE": (
        *("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"),
    ),
}
_DISTORTION_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1")
_WIDEST_TANGENT = 1.2  # 50 degrees to a side, of a pinhole that stands in for a fisheye

_LEAST_FOCAL, _MOST_FOCAL = 100.0, 1000.0
"""Of a photo's longer side: between 3 arc minutes and 179 degrees are seen."""
_FARTHEST_CENTRE = 100.0
"""Of the longer side: where the principal point of a detail may lie."""
_MOST_SIGMA = 1e100  # its square is finite
_NO_COVARIANCE = (
    "a camera's covariance must be empty or 5 rows of 5 finite numbers, symmetric and positive "
    "semi-definite"
)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera, with lens distortion if ``distortion`` is not empty, or a fisheye.

    Attributes:
        width, height: image size in pixels.
        fx, fy: focal lengths in pixels.
        cx, cy: principal point in pixels; the centre of the top-left pixel is (0.5, 0.5).
        distortion: empty, or OpenCV's (k1, k2, p1, p2, k3, k4, k5, k6); for a fisheye, that of
            COLMAP's THIN_PRISM_FISHEYE, (k1, k2, p1, p2, k3, k4, sx1, sy1).
        fisheye: whether the distance from the principal point grows with the angle (times a
            polynomial of it), not with its tangent.
        covariance: how well the camera is known, (5, 5), of ln(f), ln(fy / fx), cx / fx, cy / fy
            and k1, where f is the geometric mean of both focal lengths; empty: it is exact. It goes
            into the covariance of poses. See :meth:`unsure`.

    Raises:
        CameraError: a size or a focal length is not positive, a number is not finite, or the
            covariance is not one.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    fisheye: bool = False
    covariance: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        for size in (self.width, self.height):
            if not isinstance(size, Integral):
                raise CameraError(f"a camera's size must be whole numbers of pixels, not {size!r}")
        if self.width < 1 or self.height < 1:
            raise CameraError(f"camera size must be positive, not {self.width}x{self.height}")
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not np.all(np.isfinite(numbers)):
            raise CameraError("camera parameters must be finite numbers")
        if self.fx <= 0 or self.fy <= 0:
            raise CameraError(f"focal lengths must be positive, not {self.fx}, {self.fy}")
        if len(self.distortion) not in (0, 8):
            raise CameraError("distortion must be empty or (k1, k2, p1, p2, k3, k4, k5, k6)")
        if not isinstance(self.covariance, tuple):  # arrays neither compare nor hash
            raise CameraError(
                "a camera's covariance must be a tuple of tuples: give arrays to with_covariance"
            )
        if self.covariance and not is_covariance(self.covariance, 5):
            raise CameraError(_NO_COVARIANCE)

    @classmethod
    def pinhole(
        cls, width: int, height: int, *, fx: float, fy: float, cx: float, cy: float
    ) -> Camera:
        """A camera without distortion."""
        return cls(width, height, float(fx), float(fy), float(cx), float(cy))

    @classmethod
    def from_colmap(
        cls, model: str, width: int, height: int, parameters: Sequence[float]
    ) -> Camera:
        """A camera from a COLMAP model name and its parameters in COLMAP's order.

        Raises:
            CameraError: the model is not supported or has another number of parameters.
        """
        fisheye = model in _FISHEYE_PARAMETERS
        names = _MODEL_PARAMETERS.get(model) or _FISHEYE_PARAMETERS.get(model)
        if names is None:
            known = ", ".join([*_MODEL_PARAMETERS, *_FISHEYE_PARAMETERS])
            raise CameraError(
                f"camera model {model!r} is not supported (supported: {known}); "
                "undistort the photos to PINHOLE first"
            )
        if len(parameters) != len(names):
            raise CameraError(
                f"{model} takes {len(names)} parameters ({', '.join(names)}), got {len(parameters)}"
            )
        values = dict(zip(names, (float(p) for p in parameters), strict=True))
        distortion_names = _FISHEYE_NAMES if fisheye else _DISTORTION_NAMES
        distortion = tuple(values.get(name, 0.0) for name in distortion_names)
        return cls(
            width,
            height,
            values.get("fx", values.get("f", 0.0)),
            values.get("fy", values.get("f", 0.0)),
            values["cx"],
            values["cy"],
            distortion if any(distortion) else (),
            fisheye,
        )

    @classmethod
    def parse(cls, text: str) -> Camera:
        """A camera from ``MODEL,width,height,params...`` (commas or blanks between; sizes may be
        written as ``640.0``).

        Raises:
            CameraError: the text has another form.
        """
        words = text.replace(",", " ").split()
        try:
            model, width, height = words[0].upper(), _whole(words[1]), _whole(words[2])
            parameters = [float(word) for word in words[3:]]
        except (IndexError, ValueError):
            raise CameraError(
                f"camera {text!r} is not of the form MODEL,width,height,params... "
                "(for example PINHOLE,640,480,525.5,525.5,320,240)"
            ) from None
        return cls.from_colmap(model, width, height, parameters)

    @classmethod
    def typed(cls, text: str) -> Camera:
        """As :meth:`parse`, of what somebody typed: slips are found, with which photos would be
        looked at for long, and found nowhere.

        Raises:
            CameraError: the text has another form, or no real camera has such a focal length or
                principal point.
        """
        camera = cls.parse(text)
        width, height, side = camera.width, camera.height, max(camera.width, camera.height)
        for name, focal in (("fx", camera.fx), ("fy", camera.fy)):
            if not side / _LEAST_FOCAL <= focal <= side * _MOST_FOCAL:
                short = "short" if focal < side else "long"
                raise CameraError(
                    f"{name} = {focal:g} is far too {short} for a photo of {width}x{height}; "
                    "focal lengths are in pixels"
                )
        for name, value, extent in (("cx", camera.cx, width), ("cy", camera.cy, height)):
            if abs(value - extent / 2) > _FARTHEST_CENTRE * side:
                raise CameraError(
                    f"{name} = {value:g} is far outside of a photo of {width}x{height}; the "
                    "principal point is in pixels"
                )
        return camera

    def colmap_text(self) -> str:
        """``MODEL width height params...`` in COLMAP's words; :meth:`parse` reads it back."""
        model, distortion = "PINHOLE", self.distortion
        if self.fisheye:
            k1, k2, p1, p2, k3, k4, sx1, sy1 = distortion or (0.0,) * 8
            model = "THIN_PRISM_FISHEYE"
            if not any((p1, p2, sx1, sy1)):
                model, distortion = "OPENCV_FISHEYE", (k1, k2, k3, k4)
        elif any(distortion[4:]):
            model = "FULL_OPENCV"
        elif distortion:
            model, distortion = "OPENCV", distortion[:4]
        numbers = [self.fx, self.fy, self.cx, self.cy, *distortion]
        words = (repr(float(number)) for number in numbers)  # repr(np.float64) is not a number
        return " ".join([model, str(self.width), str(self.height), *words])

    def unsure(
        self,
        *,
        focal: float = 0.0,
        aspect: float = 0.0,
        principal: float = 0.0,
        radial: float = 0.0,
    ) -> Camera:
        """The same camera, known to these standard deviations.

        Args:
            focal: of the focal lengths, as a share of them.
            aspect: of fy / fx, as a share of it.
            principal: of either coordinate of the principal point, as a share of the focal lengths.
            radial: of k1.

        Raises:
            CameraError: one is negative, or not finite.
        """
        given = [focal, aspect, principal, principal, radial]
        try:
            sigmas = np.array(given, dtype=np.float64)
        except (ValueError, TypeError):
            raise CameraError(f"standard deviations must be numbers, not {given}") from None
        if not np.all((sigmas >= 0) & (sigmas < _MOST_SIGMA)):
            raise CameraError(f"standard deviations must be 0 or more, not {sigmas.tolist()}")
        return self.with_covariance(np.diag(sigmas**2))

    def with_covariance(self, covariance: Float64Array) -> Camera:
        """The same camera, known so well, (5, 5); see the attribute ``covariance``.

        Raises:
            CameraError: it is no covariance.
        """
        try:
            rows = np.array(covariance)
        except ValueError:
            raise CameraError(_NO_COVARIANCE) from None
        if rows.shape != (5, 5) or rows.dtype.kind not in "iuf":
            raise CameraError(_NO_COVARIANCE)
        rows = rows.astype(np.float64)
        return replace(self, covariance=tuple(map(tuple, rows.tolist())) if np.any(rows) else ())

    def covariance_matrix(self) -> Float64Array:
        """(5, 5), of zeros where the camera is exact; see the attribute ``covariance``."""
        return np.array(self.covariance) if self.covariance else np.zeros((5, 5))

    @property
    def focal_sigma(self) -> float:
        """Standard deviation of the focal lengths, as a share of them; 0 where they are exact."""
        return float(np.sqrt(self.covariance_matrix()[0, 0]))

    @property
    def is_pinhole(self) -> bool:
        """Whether the camera is free of distortion."""
        return not self.distortion and not self.fisheye

    def without_distortion(self) -> Camera:
        """The pinhole camera with the same size, focal lengths and principal point.

        In place of a fisheye, the pinhole that has its resolution in the middle, and a longer
        focal length where it would see more than 50 degrees to a side: towards 90 degrees, there
        would be nothing but stretched borders.
        """
        pinhole = replace(self, distortion=(), fisheye=False)
        if not self.fisheye:
            return pinhole
        across = max(self.cx, self.width - self.cx) / self.fx
        down = max(self.cy, self.height - self.cy) / self.fy
        longer = max(1.0, across / _WIDEST_TANGENT, down / _WIDEST_TANGENT)
        return replace(pinhole, fx=self.fx * longer, fy=self.fy * longer)

    def resized(self, width: int, height: int) -> Camera:
        """The camera of the same view at another image size.

        Pixel centres at (0.5, 0.5) make this exact: every pixel coordinate scales.
        """
        kx, ky = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * kx,
            fy=self.fy * ky,
            cx=self.cx * kx,
            cy=self.cy * ky,
        )

    def matrix(self) -> Float64Array:
        """The (3, 3) intrinsic matrix K, pixel centres at (0.5, 0.5)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def opencv_matrix(self) -> Float64Array:
        """K for OpenCV, whose top-left pixel centre is (0, 0)."""
        matrix = self.matrix()
        matrix[:2, 2] -= 0.5
        return matrix

    def check_fits(self, image_shape: tuple[int, ...], what: str) -> None:
        """Raises CameraError when an image of this shape was not taken at this camera's size."""
        height, width = image_shape[:2]
        if (width, height) != (self.width, self.height):
            raise CameraError(
                f"{what} is {width}x{height}, but its camera is {self.width}x{self.height}; "
                "give the camera for this image size"
            )


def _whole(word: str) -> int:
    """Raises ValueError where the word is no whole number."""
    number = float(word)
    if not number.is_integer():
        raise ValueError(f"{word} is not a whole number")
    return int(number)
