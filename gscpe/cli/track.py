# SPDX-License-Identifier: Apache-2.0
"""``gscpe track``: a camera followed through a video, a bag, photos, or as it films."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path

from gscpe.batch import check_outputs
from gscpe.cli.common import (
    CAMERA_HELP,
    Commands,
    add_localizing,
    localizer_settings,
    show_progress,
)
from gscpe.cli.page import add_live, check_live, live_page, stay_after
from gscpe.cli.streams import say
from gscpe.errors import GscpeError, OutputError, SequenceError
from gscpe.following import Observes, Odometry, Overlay, Tally, TrackFiles, follow, read_odometry
from gscpe.localization import Localizer
from gscpe.poses.hloc import parse_pose
from gscpe.scene import open_map
from gscpe.sequences import Frames, open_frames, read_camera
from gscpe.tracking import Motion, Tracker, TrackingSettings


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser(
        "track", help="follow a camera through a video, a ROS bag or photos, or as it films"
    )
    parser.add_argument("map", help="map folder, from gscpe build-map or make-map")
    parser.add_argument(
        "source",
        help="video; folder of photos, or list of them (name MODEL width height params, or names "
        "alone); ROS 1 or 2 bag; or device:0, a camera at this machine",
    )
    parser.add_argument(
        "--output",
        required=True,
        metavar="TRAJECTORY",
        help="poses in TUM's form: time tx ty tz qx qy qz qw, camera to world; frames without a "
        "pose are left out",
    )
    parser.add_argument("--poses", metavar="POSES", help="also: name qw qx qy qz tx ty tz")
    parser.add_argument(
        "--details",
        metavar="JSONL",
        help="one line per frame with everything that is known (default: beside the output)",
    )
    parser.add_argument(
        "--overlay",
        metavar="VIDEO",
        help="photo, render and their difference side by side (.mp4), made after the tracking",
    )
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="let the frames come at their times, as from a camera, and drop those that the "
        "tracker has no time for (of a device, always so)",
    )
    parser.add_argument(
        "--fast", action="store_true", help="frames of half the size: faster, and less exact"
    )
    _add_source(parser)
    _add_odometry(parser)
    add_live(parser)
    add_localizing(parser)
    parser.set_defaults(run=run, parser=parser)


def _add_source(parser: argparse.ArgumentParser) -> None:
    """What must be told of the frames."""
    source = parser.add_argument_group("the source")
    source.add_argument(
        "--camera",
        help=f"{CAMERA_HELP}; or a file: such a line, a COLMAP cameras.txt, YAML of ROS's "
        "camera_calibration or of FAST-LIVO2. Lists may have cameras, and bags a camera_info",
    )
    source.add_argument(
        "--images", metavar="DIR", help="folder of a list's photos (default: that of the list)"
    )
    source.add_argument(
        "--times",
        metavar="FILE",
        help="times of photos, lines of: name seconds; or of seconds alone (default: their names, "
        "where these are times)",
    )
    source.add_argument(
        "--rate", metavar="HZ", type=float, help="frames a second, in place of their times"
    )
    source.add_argument(
        "--topic", help="of a bag's images (default: the only one), for example /camera/image_raw"
    )


def _add_odometry(parser: argparse.ArgumentParser) -> None:
    """Motion that another system has measured."""
    odometry = parser.add_argument_group("odometry")
    odometry.add_argument(
        "--odometry",
        metavar="FILE",
        help="trajectory of another system in TUM's form, body to world, lengths in the map's "
        "world units: its motion between the frames tells where to expect the camera",
    )
    odometry.add_argument(
        "--odometry-sigma",
        nargs=2,
        type=float,
        metavar=("LENGTH", "DEGREES"),
        help="standard deviations of its motion from frame to frame, in world units and degrees "
        f"(default: {Motion.translation_sigma} {Motion.rotation_sigma})",
    )
    odometry.add_argument(
        "--cam-from-body",
        metavar="POSE",
        help='of the odometry\'s body in the camera: "qw qx qy qz tx ty tz" (default: the body is '
        "the camera)",
    )


def run(options: argparse.Namespace) -> int:
    check_live(options)
    output, details = _checked_outputs(options)
    odometry = _odometry(options)
    frames = _frames(options)
    wait = not (options.realtime or frames.live)
    settings = TrackingSettings.fast(wait=wait) if options.fast else TrackingSettings(wait)
    tally = Tally()
    with ExitStack() as stack:
        localizer = stack.enter_context(
            Localizer(
                open_map(options.map),
                localizer_settings(options),
                matcher=options.matcher,
                backend=options.backend,
                progress=show_progress(),
            )
        )
        page = stack.enter_context(
            live_page(options, localizer.map, [] if options.images is None else [options.images])
        )
        overlay = None
        if options.overlay is not None:
            overlay = stack.enter_context(Overlay(options.overlay, localizer, frames))
            frames = overlay.frames
        try:
            with (
                Tracker(localizer, settings) as tracker,
                TrackFiles(output, options.poses, details) as files,
            ):
                others: tuple[Observes | None, ...] = (overlay, page)
                observers: list[Observes] = [files, *(each for each in others if each is not None)]
                follow(
                    *(tracker, frames, tally, observers, odometry),
                    real_time=options.realtime,
                    progress=show_progress(),
                )
        except (KeyboardInterrupt, GscpeError) as end:
            if tally.frames:
                _report(tally, output, details, frames, odometry)
                _overlay_of_the_beginning(end, overlay, options.overlay)
                if frames.live and type(end) is KeyboardInterrupt:  # how one stops a camera
                    stay_after(page)
            raise
        _report(tally, output, details, frames, odometry)
        if overlay is not None:
            overlay.write(show_progress())
            print(f"{options.overlay}: photo, render and difference", flush=True)
        stay_after(page)
    return 0 if tally.posed else 1


def _checked_outputs(options: argparse.Namespace) -> tuple[Path, Path]:
    """The trajectory and the details; before any work, all outputs can be written."""
    output = Path(options.output)
    if not output.name:
        raise OutputError(f"--output {output} is a folder; give a file for the trajectory")
    details = Path(options.details or output.with_suffix(".details.jsonl"))
    inputs = [options.source, options.times, options.odometry, options.camera]
    check_outputs(
        [output, options.poses, details, options.overlay],
        [path for path in inputs if path is not None and Path(path).is_file()],
    )
    return output, details


def _frames(options: argparse.Namespace) -> Frames:
    return open_frames(
        options.source,
        None if options.camera is None else read_camera(options.camera),
        images=options.images,
        times=options.times,
        topic=options.topic,
        rate=options.rate,
    )


def _odometry(options: argparse.Namespace) -> Odometry | None:
    if options.odometry is None:
        if options.odometry_sigma is not None or options.cam_from_body is not None:
            options.parser.error("--odometry-sigma and --cam-from-body go with --odometry")
        return None
    cam_from_body = None if options.cam_from_body is None else parse_pose(options.cam_from_body)
    return read_odometry(options.odometry, cam_from_body, *(options.odometry_sigma or ()))


def _overlay_of_the_beginning(end: BaseException, overlay: Overlay | None, path: str) -> None:
    """Ctrl-C is how one stops a camera, so the overlay is made all the same; whoever ends a
    program by a signal does not wait for it."""
    if overlay is None:
        return
    if not isinstance(end, SequenceError) and type(end) is not KeyboardInterrupt:
        say(f"{path}: not written, because of how the tracking ended")
        return
    say(f"{path}: writing what was tracked; Ctrl-C again to leave it out")
    overlay.write(show_progress())


def _report(
    tally: Tally, output: Path, details: Path, frames: Frames, odometry: Odometry | None
) -> None:
    print(tally)
    print(f"{output}: {tally.posed} poses; details: {details}", flush=True)
    if frames.trouble is not None:
        say(frames.trouble)
    if odometry is not None and tally.without_odometry:
        first, last = odometry.span
        say(
            f"the odometry, from {first:.6f} to {last:.6f} s, does not cover "
            f"{tally.without_odometry} of these frames"
        )
