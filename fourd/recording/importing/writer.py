"""Writes a source as a capture. The source's files are linked by default, or copied on request."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from fourd.base.errors import UserError
from fourd.base.files import atomic_path, resolved, write_bytes_atomically
from fourd.base.formats.picture import write_picture
from fourd.base.progress import Track
from fourd.recording.capture.calibration import write_calibration
from fourd.recording.capture.frame_rate import NAME as RATE_NAME
from fourd.recording.capture.frame_rate import write_rate
from fourd.recording.capture.layout import VIDEOS, frame_name
from fourd.recording.capture.split import write_test_views
from fourd.recording.capture.video import VideoIndex, VideoReader
from fourd.recording.capture.video_list import Video, align_videos, common_frames, common_rate, write_video_list
from fourd.recording.importing.clock import describe_clock, describe_pictures
from fourd.recording.importing.folders import check_names
from fourd.recording.importing.imported import (
    EncodedPictures,
    Frames,
    Imported,
    PictureFiles,
    VideoFile,
    video_files,
)

JPEG_QUALITY = 95


@dataclass(frozen=True)
class ImportSettings:
    """Settings for writing a source as a capture.

    Attributes:
        copy: copy files instead of linking them.
        unpack: write the frames of videos as images.
        offsets: time offsets of the videos in frames of the capture, keyed by camera name. Missing offsets are 0. In a
            video with the offset n, each event appears n frames later than in a video with the offset 0.
    """

    copy: bool = False
    unpack: bool = False
    offsets: Mapping[str, float] = field(default_factory=dict)


def write_capture(
    imported: Imported, indices: Mapping[str, VideoIndex], out: Path, settings: ImportSettings, track: Track
) -> list[str]:
    """Write ``imported`` into the folder ``out``. Repeating an interrupted call completes the capture.

    The calibration files contain only the cameras that have a calibration.

    Args:
        imported: the source's content.
        indices: video indices by camera name.
        out: the capture's folder.
        settings: how files and frames are written.
        track: wraps loops to report progress.

    Returns:
        Notes for the user, one line each: rotation, HDR, frame rates, unused frames and long keyframe
        intervals.

    Raises:
        UserError: when a camera's name is not a valid file name, a video cannot be used, or an offset is for an unknown
            camera.
    """
    check_import(imported, settings)
    videos = align_videos(video_files(imported.cameras), indices, settings.offsets)
    notes = [*describe_pictures(videos), *describe_clock(videos)]
    if videos and len(videos) < len(imported.cameras):
        raise UserError(f"{out}: expected videos or images of all cameras, got both; import the images separately")
    if videos and settings.unpack:
        count = common_frames(videos)
        for name, video in videos.items():
            _unpack(video, out / "images" / name, count, track)
    elif videos:
        _write_videos(videos, out, settings.copy, track)
    for camera in imported.cameras:
        if camera.name not in videos:
            _write_pictures(camera.frames, out / "images" / camera.name, settings.copy, track)
        if camera.masks is not None:
            _write_pictures(camera.masks, out / "masks" / camera.name, settings.copy, track)
    rate = common_rate(videos) if videos else imported.fps
    if rate is None:
        (out / RATE_NAME).unlink(missing_ok=True)
    elif settings.unpack or not videos:
        write_rate(out, rate)
    calibrations = {camera.name: camera.calibration for camera in imported.cameras if camera.calibration is not None}
    if imported.test_views:
        write_test_views(out, imported.test_views)
    if calibrations:
        write_calibration(out, list(calibrations), list(calibrations.values()), imported.metres_per_unit)
    return notes


def check_import(imported: Imported, settings: ImportSettings) -> None:
    """Raise UserError if a camera name is not a valid file name, or an offset belongs to a camera without a video."""
    check_names([camera.name for camera in imported.cameras])
    frames = {camera.name: camera.frames for camera in imported.cameras}
    for name in settings.offsets:
        if name not in frames:
            raise UserError(f"--offset: expected a camera among {', '.join(frames)}, got '{name}'; name one of them")
        if not isinstance(frames[name], VideoFile):
            raise UserError(
                f"--offset: expected a video of '{name}', got images; rename the images to align the frames"
            )


def _write_videos(videos: Mapping[str, Video], out: Path, copy: bool, track: Track) -> None:
    written = {}
    for name in track(list(videos), len(videos), "copying" if copy else "linking"):
        video = videos[name]
        target = out / VIDEOS / f"{name}{video.path.suffix}"
        _link_or_copy(video.path, target, copy)
        written[name] = replace(video, path=target)
    write_video_list(out, written)


def _write_pictures(frames: Frames, folder: Path, copy: bool, track: Track) -> None:
    if isinstance(frames, PictureFiles):
        for path, name in track(list(zip(frames.paths, frames.names, strict=True)), len(frames.paths), folder.name):
            _link_or_copy(path, folder / f"{name}{path.suffix.lower()}", copy)
    elif isinstance(frames, EncodedPictures):
        for number, name in track(list(enumerate(frames.names)), frames.count, folder.name):
            target = folder / f"{name}{frames.suffix}"
            if not target.exists():
                write_bytes_atomically(target, frames.read(number))


def _unpack(video: Video, folder: Path, count: int, track: Track) -> None:
    with VideoReader(video.path, video.index) as reader:
        for number in track(range(count), count, folder.name):
            target = folder / f"{frame_name(number)}.jpg"
            if target.exists():
                continue
            bgr = np.asarray(cv2.cvtColor(reader.read(video.number(number)), cv2.COLOR_RGB2BGR), np.uint8)
            write_picture(target, bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])


def _link_or_copy(source: Path, target: Path, copy: bool) -> None:
    """Link ``target`` to ``source``, or copy ``source`` to ``target``, unless the same link or copy already exists."""
    source = resolved(source)
    if target.is_symlink() or target.exists():
        is_link = resolved(target) == source
        if (is_link and not (copy and target.is_symlink())) or (
            copy and not target.is_symlink() and _same_size(source, target)
        ):
            return
        if not is_link:
            raise UserError(
                f"{target}: expected no file or the same file, got another file; import into another folder"
            )
    target.parent.mkdir(parents=True, exist_ok=True)
    if copy:
        with atomic_path(target) as temporary:
            shutil.copyfile(source, temporary)
    else:
        os.symlink(source, target)


def _same_size(source: Path, target: Path) -> bool:
    return source.stat().st_size == target.stat().st_size
