# SPDX-License-Identifier: Apache-2.0
"""What a pose must show to be trusted."""

from __future__ import annotations

from dataclasses import dataclass, field

from gscpe.localization.wrong_camera import CameraCheckSettings
from gscpe.ranges import check_kinds, check_numbers, check_shares, check_whole


@dataclass(frozen=True)
class VerificationSettings:
    """What a pose must show (measured: docs/how-it-works.md, section Verification).

    Attributes:
        min_inliers: matches that agree with the coarse pose.
        min_inlier_share: ... as a share of all matches.
        min_spread: share of a 4x4 grid over the photo that holds an inlier.
        min_agreement: local correlation of photo and render, at half size.
        decisive_inliers: matches that agree, from which on photo and render need to be alike only
            in part, because half of the photo shows what has been moved or come since, ...
        decisive_inlier_share: ... as a share of all matches, ...
        decisive_spread: ... and the share of the grid that they hold: more than that of a photo
            whose halves were exchanged.
        decisive_agreement: what ``min_agreement`` is then. Below ...
        changed_agreement: ... this, what does not look like the map is left out, and the rest is
            aligned again.
        rival_spread: where many matches agree on another pose, which contradicts this one,
            something has been moved as a whole. Then the matches of this pose must hold this share
            of the grid, ...
        rival_margin: ... and by so much more of it than those of the other; if they are also
            ``decisive_inliers``, those of the other are not counted in the share of all.
        min_tracking_agreement: ``min_agreement`` for a pose from an alignment alone.
        sure_agreement: below it, further starts are tried too, and the best is kept.
        min_overlap: share of the photo that shows the map.
        max_shift: metres that refinement may move the coarse pose, and ... (lengths are for
            scenes 2 m away; they grow with the depth where it is more, or its unit unknown)
        max_shift_degrees: ... turn it; more means that the two contradict each other.
        max_sigma: metres of the pose's standard deviation in its worst direction, and ...
        max_sigma_degrees: ... the same for the rotation; more: the photo does not determine the
            pose. If only the alignment does not, the deviations of the mean with the matches must
            be at most half of this.
        prior_sigmas: deviations of a prior by which an alignment without matches may leave it.
        camera: how far matches may contradict the camera.

    Raises:
        SettingsError: a value is out of its range.
    """

    min_inliers: int = 20
    min_inlier_share: float = 0.5
    min_spread: float = 0.2
    min_agreement: float = 0.25
    decisive_inliers: int = 200
    decisive_inlier_share: float = 0.55
    decisive_spread: float = 0.55
    decisive_agreement: float = 0.1
    changed_agreement: float = 0.4
    rival_spread: float = 0.65
    rival_margin: float = 0.15
    min_tracking_agreement: float = 0.5
    sure_agreement: float = 0.6
    min_overlap: float = 0.2
    max_shift: float = 0.1
    max_shift_degrees: float = 3.0
    max_sigma: float = 0.1
    max_sigma_degrees: float = 3.0
    prior_sigmas: float = 4.0
    camera: CameraCheckSettings = field(default_factory=CameraCheckSettings)

    def __post_init__(self) -> None:
        check_whole(self, "min_inliers", "decisive_inliers", least=0)
        check_shares(self, "min_inlier_share", "min_spread", "min_overlap")
        check_shares(self, "decisive_inlier_share", "decisive_spread")
        check_shares(self, "rival_spread", "rival_margin")
        agreements = "min_agreement", "min_tracking_agreement", "sure_agreement"
        check_numbers(
            self, *agreements, "decisive_agreement", "changed_agreement", least=-1, most=1
        )
        check_numbers(
            self,
            "max_shift",
            "max_shift_degrees",
            "max_sigma",
            "max_sigma_degrees",
            "prior_sigmas",
            least=0,
            infinite=True,
        )
        check_kinds(self, camera=CameraCheckSettings)
