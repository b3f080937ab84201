"""Calibration of a rig from a folder of videos of a moving board: detection, fit, world frame and results."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.files import atomic_folder
from fourd.base.progress import Log, Track
from fourd.recording.board_calibration.adjustment.rig import Poses, RigState
from fourd.recording.board_calibration.detection import BoardDetector, BoardView
from fourd.recording.board_calibration.diagnosis import measure_marker_ratio, suggest_fix
from fourd.recording.board_calibration.drawing import draw_rig
from fourd.recording.board_calibration.fit import RigFit, RigInput, fit_rig, locate_boards
from fourd.recording.board_calibration.initial import locate_views
from fourd.recording.board_calibration.lenses import match_lenses, read_lenses
from fourd.recording.board_calibration.report import CameraReport, report_cameras, report_content, time_lines
from fourd.recording.boards import CalibrationBoard
from fourd.recording.capture.calibration import write_calibration
from fourd.recording.capture.layout import EXTRINSICS_NAME, INTRINSICS_NAME, parse_frame_range, sample_indices
from fourd.recording.capture.video import VideoIndex, index_video
from fourd.recording.importing.folders import check_names, find_frames
from fourd.recording.importing.given_calibration import REPORT
from fourd.recording.importing.imported import Imported, ImportedCamera, PictureFiles, video_files
from fourd.recording.importing.pictures.moments import align_pictures
from fourd.recording.importing.sample_frames import SynchronizedFrames

Grey = NDArray[np.uint8]

DRAWING = "rig.png"
MAX_FRAMES = 400
"""Maximum number of frames that are searched if --frames is not given."""
MIN_FRAMES = 3
SAMPLED_PICTURES = 5
"""If no board is found, the program examines this number of images per camera to find the reason."""
RATIO_PICTURES = 6
MAX_RATIO_DIFFERENCE = 0.04
"""Maximum relative difference between the measured and the given ratio of a marker's side to a square's side."""


@dataclass(frozen=True)
class CalibrationSettings:
    """A user's settings for a calibration.

    Attributes:
        board: the board in the videos.
        board_file: the board's file, for error messages.
        intrinsics: folder or file with known lenses, or None to estimate all lenses.
        frames: range A:B[:S] of the frames to search. If None, all frames are searched, or 400 evenly spaced frames if
            there are more.
        floor_frame: number of a frame in which the board lies on the floor, or None. With a floor frame, the world's
            origin is a corner of the board, and z points up. Otherwise, the world has the axes of the first camera.
        offsets: delay, in frames, of each camera's video, by camera name.
    """

    board: CalibrationBoard
    board_file: Path
    intrinsics: Path | None = None
    frames: str | None = None
    floor_frame: int | None = None
    offsets: Mapping[str, float] = field(default_factory=dict)


def calibrate_rig(source: Path, out: Path, settings: CalibrationSettings, *, log: Log, warn: Log, track: Track) -> None:
    """Calibrate the cameras of ``source`` and write intri.yml, extri.yml, report.json and rig.png into ``out``.

    Args:
        source: folder that contains, for each camera, a video or a folder of images. All cameras record the same
            moving board.
        out: a new folder, an empty folder, or the folder of an earlier calibration, which is replaced completely.
        settings: the user's settings.
        log: called with one line per result or choice.
        warn: called with one line for each value that is badly determined.
        track: progress callback.

    Raises:
        UserError: if an input is invalid, or the views of the board do not determine the rig. No file is then written.
    """
    check_out(out)
    if not source.is_dir():
        raise UserError(f"{source}: expected a folder with videos of the board, got no folder; check the path")
    cameras = tuple(ImportedCamera(name, None, frames) for name, frames in find_frames(source).items())
    check_names([camera.name for camera in cameras])
    files = video_files(cameras)
    indices = {name: index_video(files[name]) for name in track(list(files), len(files), "videos")} if files else {}
    _check_counts(cameras, indices, settings.offsets)
    aligned, missing = align_pictures(Imported(cameras, ()), "auto")
    for line in missing:
        warn(line)
    cameras = aligned.cameras
    with SynchronizedFrames(cameras, indices, settings.offsets) as frames:
        numbers = _frame_numbers(frames, source, settings, log)
        first = frames.pictures(numbers[0])
        sizes = tuple((picture.shape[1], picture.shape[0]) for picture in first)
        lenses = _known_lenses(settings, frames.names, sizes, log)
        views = _detect(frames, numbers, source, settings, track)
        _check_ratio(frames, views, settings)
    turns = tuple(indices[name].turn if name in indices else 0 for name in frames.names)
    rig = RigInput(str(source), frames.names, sizes, lenses, settings.board, tuple(views), turns)
    fit = fit_rig(rig, track)
    moved = fit if settings.floor_frame is None else _lay_on_floor(fit, views, settings)
    reports = report_cameras(moved, frames.names)
    # The frames of all videos are put on a common clock, which has the lowest frame rate of the videos.
    fps = min((float(index.fps) for index in indices.values()), default=None)
    _write(out, source, settings, frames.names, moved, reports, fps)
    _log_results(moved, reports, log, warn)
    for line in time_lines(moved, frames.names, fps):
        log(line)


def check_out(out: Path) -> None:
    """Raise UserError unless ``out`` is a new folder, an empty folder, or the folder of an earlier calibration."""
    if out.is_dir() and all((out / name).is_file() for name in (INTRINSICS_NAME, EXTRINSICS_NAME, REPORT)):
        known = {INTRINSICS_NAME, EXTRINSICS_NAME, REPORT, DRAWING}
        if set(os.listdir(out)) <= known:
            return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        got = "a folder with other files" if out.is_dir() else "a file"
        raise UserError(f"{out}: expected a new folder or an earlier calibration, got {got}; name another folder")


def _check_counts(
    cameras: Sequence[ImportedCamera], indices: Mapping[str, VideoIndex], offsets: Mapping[str, float]
) -> None:
    """Raise UserError if there is only one camera, a video has too few frames, or the offsets name an unknown
    camera."""
    names = [camera.name for camera in cameras]
    for name in offsets:
        if name not in names:
            raise UserError(f"--offset: expected cameras among {', '.join(names)}, got '{name}'; name one of them")
    files = video_files(cameras)
    for camera in cameras:
        if isinstance(camera.frames, PictureFiles):
            where, count = camera.frames.paths[0].parent, len(camera.frames.paths)
        else:
            where, count = files[camera.name], indices[camera.name].frames
        if count < MIN_FRAMES:
            raise UserError(
                f"{where}: expected at least {MIN_FRAMES} frames of a moving board, got {count}; film the board for "
                "half a minute"
            )
    if len(cameras) == 1:
        raise UserError(
            f"{names[0]}: expected videos of at least two cameras, got one; put the videos of all cameras in one folder"
        )


def _frame_numbers(frames: SynchronizedFrames, source: Path, settings: CalibrationSettings, log: Log) -> list[int]:
    """Return the numbers of the frames to search."""
    numbers = list(parse_frame_range(settings.frames, frames.count, "video"))
    if settings.frames is None and len(numbers) > MAX_FRAMES:
        numbers = sample_indices(frames.count, MAX_FRAMES)
        log(f"{len(numbers)} of {frames.count} frames are searched, evenly spaced; choose others by --frames")
    floor = settings.floor_frame
    if floor is not None:
        if not 0 <= floor < frames.count:
            raise UserError(
                f"--floor-frame: expected 0 to {frames.count - 1}, since the videos in {source} have {frames.count} "
                f"frames, got {floor}; name a frame in which the board lies on the floor"
            )
        numbers = sorted({*numbers, floor})
    return numbers


def _known_lenses(
    settings: CalibrationSettings, names: Sequence[str], sizes: Sequence[tuple[int, int]], log: Log
) -> tuple[Camera | None, ...]:
    if settings.intrinsics is None:
        return (None,) * len(names)
    lenses = match_lenses(settings.intrinsics, read_lenses(settings.intrinsics), names, sizes)
    unknown = [name for name, lens in zip(names, lenses, strict=True) if lens is None]
    if unknown:
        log(f"{settings.intrinsics}: no lens for {', '.join(unknown)}; these lenses are estimated from the board")
    return lenses


def _detect(
    frames: SynchronizedFrames, numbers: Sequence[int], source: Path, settings: CalibrationSettings, track: Track
) -> list[BoardView]:
    """Find the board in all frames.

    Raises:
        UserError: if a camera never sees the board. If the camera sees a different board, the message describes
            that board.
    """
    detector = BoardDetector(settings.board)
    views: list[BoardView] = []
    blind = []
    for camera, name in enumerate(frames.names):
        before = len(views)
        for number in track(numbers, len(numbers), f"board in {name}"):
            view = detector.detect(_grey(frames, camera, number), camera, number)
            if view is not None:
                views.append(view)
        if len(views) == before:
            blind.append(camera)
    if not blind:
        return views
    names = ", ".join(frames.names[camera] for camera in blind)
    sampled = [numbers[index] for index in sample_indices(len(numbers), SAMPLED_PICTURES)]
    pictures = [_grey(frames, camera, number) for camera in blind[:2] for number in sampled]
    for _ in track(range(1), 1, "other boards"):
        fix = suggest_fix(settings.board, pictures)
    if fix is not None:
        raise UserError(
            f"{settings.board_file}: expected a {settings.board.describe()} in {source}, got none in {names}; the "
            f"images show a board with {fix}; correct the board's file"
        )
    if views and len(frames.names) - len(blind) == 1:
        seen = next(name for camera, name in enumerate(frames.names) if camera not in blind)
        raise UserError(
            f"{source}: expected two cameras that see the board, got only {seen}; hold the board where several "
            "cameras see it"
        )
    raise UserError(
        f"{source}: expected a {settings.board.describe()} ({settings.board_file}) in each video, got none in {names}; "
        "film the whole board in good light and without fast motion, or remove the videos of these cameras"
    )


def _check_ratio(frames: SynchronizedFrames, views: Sequence[BoardView], settings: CalibrationSettings) -> None:
    """Raise UserError if the markers do not have the given size relative to the squares."""
    board = settings.board
    if board.marker_m is None:
        return
    largest = sorted(views, key=lambda view: -float(np.ptp(view.pixels, axis=0).min()))[:RATIO_PICTURES]
    measured = measure_marker_ratio(board, (_grey(frames, view.camera, view.frame) for view in largest))
    given = board.marker_m / board.square_m
    if measured is not None and abs(measured / given - 1) > MAX_RATIO_DIFFERENCE:
        raise UserError(
            f"{settings.board_file}: marker_m: expected {measured:.3f} squares as measured in the videos, got "
            f"{given:.3f} squares; measure a square and a marker on the printed board, and correct the file"
        )


def _grey(frames: SynchronizedFrames, camera: int, number: int) -> Grey:
    return np.asarray(cv2.cvtColor(frames.picture(camera, number), cv2.COLOR_RGB2GRAY), np.uint8)


def _lay_on_floor(fit: RigFit, views: Sequence[BoardView], settings: CalibrationSettings) -> RigFit:
    """Move the origin and the axes of the world to the board in the floor frame. z points to the side from which the
    cameras see the board."""
    frame = settings.floor_frame
    some = [view for view in views if view.frame == frame]
    if not some or frame is None:
        raise UserError(
            f"--floor-frame: expected a frame in which a camera sees the board on the floor, got {frame}, in which no "
            "board is found; name another frame"
        )
    rig = RigState(fit.cameras, fit.boards)
    board = locate_boards(settings.board, rig, locate_views(settings.board, fit.cameras, some), [frame])
    to_board = board.inverse()
    heights = [
        float(to_board.rotation[0, 2] @ fit.cameras[view.camera].centre + to_board.translation[0, 2]) for view in some
    ]
    if np.median(heights) < 0:
        # Here, the back of a double-sided board faces up. A rotation by 180 degrees about x makes z point up.
        flip = Poses(np.diag([1.0, -1.0, -1.0])[None], np.zeros((1, 3)))
        to_board = flip.after(to_board)
    to_world = to_board.inverse()
    cameras = tuple(
        replace(
            camera,
            rotation=camera.rotation @ to_world.rotation[0],
            translation=camera.rotation @ to_world.translation[0] + camera.translation,
        )
        for camera in fit.cameras
    )
    return replace(fit, cameras=cameras, boards=to_board.after(fit.boards))


def _write(
    out: Path,
    source: Path,
    settings: CalibrationSettings,
    names: Sequence[str],
    fit: RigFit,
    reports: Sequence[CameraReport],
    fps: float | None,
) -> None:
    with atomic_folder(out) as folder:
        write_calibration(folder, names, fit.cameras, metres_per_unit=1.0)
        floor = settings.floor_frame is not None
        draw_rig(folder / DRAWING, names, fit.cameras, settings.board, fit.boards, floor)
        content: dict[str, Any] = {
            "version": 1,
            "source": str(source),
            "board": asdict(settings.board),
            "intrinsics": None if settings.intrinsics is None else str(settings.intrinsics),
            "offsets": dict(settings.offsets),
            "floor_frame": settings.floor_frame,
        }
        content |= report_content(fit, names, reports, fps)
        (folder / REPORT).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _log_results(fit: RigFit, reports: Sequence[CameraReport], log: Log, warn: Log) -> None:
    count = int(fit.held_out.sum())
    log(f"{count} held-out frames measure the error; the final fit uses all {len(fit.frames)} frames")
    for report in reports:
        log(report.line())
    for report in reports:
        for line in report.warnings:
            warn(line)
