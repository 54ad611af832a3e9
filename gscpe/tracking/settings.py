# SPDX-License-Identifier: Apache-2.0
"""Settings of the tracker."""

from __future__ import annotations

from dataclasses import dataclass, field

from gscpe.errors import SettingsError
from gscpe.ranges import check_kinds, check_numbers, check_shares, check_whole
from gscpe.refinement import LucasKanadeSettings, UncertaintySettings, VisibilitySettings


@dataclass(frozen=True)
class TrustSettings:
    """What a frame must show, so that its pose is reported (measured: docs/benchmarks.md).

    Attributes:
        min_agreement: correlation of anchor and frame, mean over blocks of the picture.
        min_alike: share of the blocks whose correlation is above one half.
        sure_agreement: what ``min_agreement`` is when a camera is found again without matches.
        min_overlap: share of the anchor's pixels that the frame shows.
        max_gain: largest factor of contrast between anchor and frame, either way.
        max_sigma: metres, standard deviation of the pose in its worst direction, and ...
        max_sigma_degrees: ... of its rotation. Lengths are for surfaces 2 m away or nearer.
        max_surprise_pixels: a frame that moved so much further than was predicted must show the
            sure agreement.
        check_frames: so many frames after the last check, matches with a render confirm the pose.
        max_unconfirmed: checks in a row that may find too few matches.
    """

    min_agreement: float = 0.5
    min_alike: float = 0.4
    sure_agreement: float = 0.6
    min_overlap: float = 0.25
    max_gain: float = 10.0
    max_sigma: float = 0.1
    max_sigma_degrees: float = 3.0
    max_surprise_pixels: float = 30.0
    check_frames: int = 60
    max_unconfirmed: int = 2

    def __post_init__(self) -> None:
        check_numbers(self, "min_agreement", "sure_agreement", least=-1, most=1)
        check_shares(self, "min_alike", "min_overlap")
        check_numbers(self, "max_gain", least=1, infinite=True)
        check_numbers(
            self,
            "max_sigma",
            "max_sigma_degrees",
            "max_surprise_pixels",
            least=0,
            infinite=True,
        )
        check_whole(self, "check_frames", least=1)
        check_whole(self, "max_unconfirmed", least=0)


@dataclass(frozen=True)
class TrackingSettings:
    """Settings of a :class:`gscpe.Tracker`. Pixels are those of the frame as it is aligned: at
    the resolution of the map's references, times ``scale``.

    Attributes:
        wait: frames wait for the localizer where the camera is not known, and for the next anchor
            where the last is far. For files; a live camera must not wait.
        scale: of the frames; see :meth:`fast`.
        levels: times the images are halved.
        template_pixels: of an anchor at full size, ...
        coarse_pixels: ... and in each smaller image, at most.
        judged_pixels: ... of these are enough for the covariance.
        anchor_pixels: the next anchor is rendered before the image has moved further than this from
            all anchors (root mean square).
        farthest_pixels: beyond this, a frame waits for the next anchor if it may wait.
        anchors: so many are kept, for cameras that turn back.
        between: a frame between two anchors is aligned with both.
        patience: frames without a pose until the localizer is asked; with ``wait``, it is asked at
            once for a frame that does not look like the map.
        kept_frames: frames that are kept while it works, to carry its answer forward.
        solver: at each level; ``max_template_pixels`` is replaced by the pixels above.
        visibility: mask of the anchors.
        uncertainty: of the covariance.
        trust: when a pose is reported.
    """

    wait: bool = False
    scale: float = 1.0
    levels: int = 4
    template_pixels: int = 20_000
    coarse_pixels: int = 5_000
    judged_pixels: int = 10_000
    anchor_pixels: float = 8.0
    farthest_pixels: float = 40.0
    anchors: int = 4
    between: bool = True
    patience: int = 3
    kept_frames: int = 60
    solver: LucasKanadeSettings = field(
        default_factory=lambda: LucasKanadeSettings(
            max_iterations=40, converged_pixels=0.04, extrapolate=True
        )
    )
    visibility: VisibilitySettings = field(default_factory=lambda: VisibilitySettings(views=0))
    uncertainty: UncertaintySettings = field(default_factory=UncertaintySettings)
    trust: TrustSettings = field(default_factory=TrustSettings)

    @classmethod
    def fast(cls, *, wait: bool = False) -> TrackingSettings:
        """For frames of half the size: faster, and less exact."""
        return cls(
            wait=wait,
            scale=0.5,
            template_pixels=7_500,
            coarse_pixels=3_000,
            judged_pixels=5_000,
            anchor_pixels=6.0,
            farthest_pixels=18.0,
            between=False,
        )

    def __post_init__(self) -> None:
        check_kinds(
            self,
            wait=bool,
            between=bool,
            solver=LucasKanadeSettings,
            visibility=VisibilitySettings,
            uncertainty=UncertaintySettings,
            trust=TrustSettings,
        )
        check_numbers(self, "scale", above=0, most=1)
        check_numbers(self, "anchor_pixels", "farthest_pixels", above=0)
        check_whole(self, "levels", "patience", least=1)
        check_whole(self, "anchors", "kept_frames", least=2)
        check_whole(
            self,
            "template_pixels",
            "coarse_pixels",
            "judged_pixels",
            least=self.solver.min_pixels,
        )
        if self.anchor_pixels > self.farthest_pixels:
            raise SettingsError(
                "tracking needs anchor_pixels <= farthest_pixels, not "
                f"{self.anchor_pixels} and {self.farthest_pixels}"
            )
