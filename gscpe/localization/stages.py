# SPDX-License-Identifier: Apache-2.0
"""One attempt: matches and alignment from one start, and whether to trust them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gscpe.coarse import CoarseResult, estimate_coarse_pose
from gscpe.localization.attempt import Attempt
from gscpe.localization.beside import Beside
from gscpe.localization.easy import localize_easy
from gscpe.localization.light import exposed_like
from gscpe.localization.matchers import NamedMatcher
from gscpe.localization.observer import Observer
from gscpe.localization.prepared import PreparedPhoto
from gscpe.localization.settings import LocalizerSettings
from gscpe.localization.starts import PosePrior, Start
from gscpe.localization.verification import (
    are_decisive,
    doubt_about_aligned,
    doubt_about_coarse,
    doubt_about_tracked,
)
from gscpe.photos import Photo
from gscpe.refinement import RefinementResult, refine_pose
from gscpe.refinement.changes import without_changes
from gscpe.render import Renderer, Renders
from gscpe.scene import MapFrame


@dataclass(frozen=True, eq=False)
class Stages:
    """All stages for photos of one map; everything is with respect to the map's own frame.

    Attributes:
        frame: of the map.
        settings: of every stage.
        renderer: of the map's splat.
        beside: a second thread.
    """

    frame: MapFrame
    settings: LocalizerSettings
    renderer: Renderer
    beside: Beside

    def track(
        self, query: PreparedPhoto, start: Start, prior: PosePrior, observer: Observer
    ) -> Attempt:
        """Aligns from a near prior, without matches."""
        settings = self.settings
        with query.clock.stage("refinement"):
            refinement = replace(settings.refinement, levels=settings.tracking_levels)
            aligned = refine_pose(
                self.renderer, query.photo, start.cam_from_world, refinement, observer
            )
        doubt = doubt_about_tracked(prior, aligned, settings.verification, self.frame)
        return Attempt(start, None, aligned, doubt)

    def attempt(
        self,
        query: PreparedPhoto,
        start: Start,
        named: NamedMatcher,
        observer: Observer,
        renderer: Renders,
    ) -> Attempt:
        """Matches and alignment: with one render each where the photo is easy, else with the whole
        coarse loop."""
        settings = self.settings
        query.begin()
        if query.small_camera is not None:
            found = localize_easy(
                renderer,
                named.matcher,
                query,
                query.small_camera,
                start.cam_from_world,
                self.beside,
                settings.easy,
                settings.coarse,
                settings.refinement,
                observer,
            )
            if found is not None and self._doubt(query, *found) is None:
                return Attempt(start, *found, None, matcher=named.name)
        return self.hard_attempt(query, start, named, observer, renderer)

    def hard_attempt(
        self,
        query: PreparedPhoto,
        start: Start,
        named: NamedMatcher,
        observer: Observer,
        renderer: Renders,
    ) -> Attempt:
        """The whole coarse loop, and the alignment, of a photo that is known not to be easy."""
        settings = self.settings
        prepared = query.prepared_for(named.matcher)
        with query.clock.stage("coarse"):
            coarse = estimate_coarse_pose(
                renderer,
                named.matcher,
                prepared,
                query.photo.camera,
                start.cam_from_world,
                settings.coarse,
                observer,
                exposed_like(query.photo, settings.refinement.light.clipping),
            )
        query.has_moved |= len(coarse.rival_pixels) > 0
        doubt = self._doubt_about_coarse(query, coarse)
        if doubt is not None or coarse.cam_from_world is None:
            return Attempt(start, coarse, None, doubt, matcher=named.name)
        with query.clock.stage("refinement"):
            aligned = refine_pose(
                renderer, query.photo, coarse.cam_from_world, settings.refinement, observer
            )
        doubt = self._doubt(query, coarse, aligned)
        if doubt is not None:
            with query.clock.stage("refinement"):
                aligned = self._aligned_without_changes(query.photo, coarse, aligned, observer)
            doubt = self._doubt(query, coarse, aligned)
        return Attempt(start, coarse, aligned, doubt, matcher=named.name)

    def _aligned_without_changes(
        self, photo: Photo, coarse: CoarseResult, aligned: RefinementResult, observer: Observer
    ) -> RefinementResult:
        """An alignment that is in doubt again, without what does not look like the map, if that is
        much of the photo, although its matches leave no doubt about the place. How much photo and
        map are alike remains that of the whole photo. (Alignments that are not in doubt gain
        nothing by it, and become too sure.)"""
        verification, pose = self.settings.verification, coarse.cam_from_world
        unlike = not aligned.agreement >= verification.changed_agreement
        if pose is None or not unlike or not are_decisive(coarse, photo.camera, verification):
            return aligned
        view = self.renderer.render(photo.camera, pose)
        unchanged = without_changes(photo, view)
        if unchanged is None:
            return aligned
        again = refine_pose(
            self.renderer, unchanged, pose, self.settings.refinement, observer, view
        )
        if again.cam_from_world is None:
            return aligned
        return replace(again, agreement=aligned.agreement, overlap=aligned.overlap)

    def _doubt(
        self, query: PreparedPhoto, coarse: CoarseResult, aligned: RefinementResult
    ) -> str | None:
        verification, camera = self.settings.verification, query.photo.camera
        return self._doubt_about_coarse(query, coarse) or doubt_about_aligned(
            coarse, aligned, camera, verification, self.settings.fusion, self.frame
        )

    def _doubt_about_coarse(self, query: PreparedPhoto, coarse: CoarseResult) -> str | None:
        verification = self.settings.verification
        return doubt_about_coarse(coarse, query.photo.camera, verification, query.has_moved)
