"""The part of ``fourd info`` that reads a video. It runs in a child process, which imports as little as possible."""

from __future__ import annotations

from pathlib import Path

import av

from fourd.base.errors import UserError
from fourd.cli.scenes.description.values import bytes_text
from fourd.recording.capture.frame_rate import format_rate
from fourd.recording.capture.streams.container import frame_count, open_container, video_stream
from fourd.recording.capture.video import first_frame


def describe_video(name: str) -> list[tuple[str, str]]:
    """Return the rows of a video's description, as (name, value)."""
    path = Path(name)
    try:
        with open_container(path) as container:
            stream = video_stream(path, container)
            rate = float(stream.average_rate or 0)
            seconds = float(container.duration or 0) / av.time_base
            frames = frame_count(stream) or round(seconds * rate)
            return [
                ("frames", f"{frames} at {format_rate(rate)} per second, {seconds:.2f} s"),
                ("image size", _turned_size(path)),
                ("codec", stream.codec_context.name),
                ("size", bytes_text(path.stat().st_size)),
            ]
    except (av.FFmpegError, ValueError, OverflowError, OSError) as error:
        raise UserError(f"{path}: expected a whole video, got a damaged file; copy it again") from error


def _turned_size(path: Path) -> str:
    """Describe the frames of a video: their size when upright, the angle by which fourd turns them upright, and the HDR
    transfer function, if any."""
    width, height, turn, transfer = first_frame(path)
    turned = f", turned by {360 - turn} degrees clockwise" if turn else ""
    return f"{width} x {height}{turned}" + (f", HDR ({transfer})" if transfer else "")
