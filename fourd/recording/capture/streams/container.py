"""Opening of video files, and the choice of the video stream that is read."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import av
from av.container import InputContainer
from av.stream import Disposition
from av.video.stream import VideoStream

from fourd.base.errors import UserError
from fourd.base.limits import require_regular

CONTAINERS = "mov,mp4,matroska,webm,avi,mpegts,mpeg,h264,hevc"
"""Names of the FFmpeg demuxers for the formats of :data:`fourd.recording.capture.layout.VIDEO_SUFFIXES`, and for raw
streams. Raw streams are included so that a later check can reject them with an error message that explains the fix."""
NOT_THE_RECORDING = Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image
"""Kinds of video streams that show no recording: covers, and thumbnails of chapters."""


def open_container(path: Path) -> InputContainer:
    """Open a video file. Raises av.FFmpegError or OSError if the file is not a video.

    Only the container formats of :data:`CONTAINERS` are read, and only from the file itself, because other formats,
    such as playlists, could make FFmpeg open more files or network addresses.

    Raises:
        UserError: if the file is a named pipe, a socket or a device.
    """
    require_regular(path)
    limits = {"protocol_whitelist": "file", "format_whitelist": CONTAINERS}
    return av.open(str(path), options=limits, metadata_errors="replace")


def recorded_streams(container: InputContainer) -> list[VideoStream]:
    """Return the video streams of a file that can show its recording, the largest first.

    Covers and thumbnails are left out, and so are streams of one frame if another stream has more frames.
    """
    streams = [stream for stream in container.streams.video if not stream.disposition & NOT_THE_RECORDING]
    moving = [stream for stream in streams if stream.frames != 1]
    return sorted(moving or streams, key=lambda stream: (-stream.width * stream.height, stream.index))


def video_stream(path: Path, container: InputContainer) -> VideoStream:
    """Return the stream of a video that fourd reads: the one with the most pixels, without covers and thumbnails.

    Raises:
        UserError: if the file has no such stream.
    """
    streams = recorded_streams(container)
    if streams:
        return streams[0]
    got = "only a cover picture" if container.streams.video else "a file without a video stream"
    raise UserError(f"{path}: expected a video, got {got}; remove the file")


def stream_at(path: Path, container: InputContainer, index: int) -> VideoStream:
    """Return the video stream with the number ``index`` of a file. Raises UserError if there is none."""
    if index < len(container.streams) and container.streams[index].type == "video":
        return cast(VideoStream, container.streams[index])
    raise UserError(f"{path}: expected a video in stream {index}, got none; import the video again")


def damaged(path: Path, error: Exception) -> UserError:
    """Create the error for a video that FFmpeg cannot read."""
    reason = getattr(error, "strerror", None) or str(error)
    return UserError(f"{path}: expected a complete video, got '{reason}'; copy the file again")


def truncated(path: Path, got: int, declared: int) -> UserError:
    """Create the error for a video with fewer frames than its header declares."""
    return UserError(f"{path}: expected {declared} frames, got {got}; copy or record the video again")


def frame_count(stream: av.video.stream.VideoStream) -> int:
    """Return the number of frames according to the header, estimated from the duration if needed; 0 if unknown."""
    seconds = (stream.duration or 0) * (stream.time_base or 0)
    return stream.frames or round(seconds * (stream.average_rate or 0))
