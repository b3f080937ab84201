"""Small videos. Every frame shows its own number, so that a test detects a wrong frame."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

WIDTH, HEIGHT = 32, 48
BLOCK = 16
BITS = (WIDTH // BLOCK) * (HEIGHT // BLOCK)
KEYFRAME_INTERVAL = 10
OPTIONS = {
    "libx264": {
        "g": str(KEYFRAME_INTERVAL),
        "bf": "2",
        "x264-params": "b-adapt=0:scenecut=0:keyint_min=10",
        "crf": "12",
    },
    "libvpx-vp9": {"g": str(KEYFRAME_INTERVAL), "deadline": "realtime", "cpu-used": "8", "crf": "20", "b": "0"},
}


def numbered_picture(number: int) -> Picture:
    """A picture, (48, 32, 3) RGB, that shows a number. Each of the six blocks is bright or dark and stands for one bit.
    The three channels have different levels."""
    bits = (number >> np.arange(BITS)) & 1
    blocks = np.where(bits, 210, 40).reshape(HEIGHT // BLOCK, WIDTH // BLOCK)
    grey = np.kron(blocks, np.ones((BLOCK, BLOCK)))
    return np.stack([grey + 30, grey, grey - 30], axis=2).astype(np.uint8)


def number_of(picture: Picture) -> int:
    """The number that a decoded frame shows."""
    means = picture[..., 1].reshape(HEIGHT // BLOCK, BLOCK, WIDTH // BLOCK, BLOCK).mean(axis=(1, 3))
    return int(((means.ravel() > 125) << np.arange(BITS)).sum())


def write_numbered_video(
    path: Path,
    numbers: Sequence[int] = tuple(range(40)),
    *,
    codec: str = "libx264",
    fps: int = 30,
    times: Sequence[int] | None = None,
    index_first: bool = False,
) -> Path:
    """Write a video of numbered images at ``fps``. ``times`` replaces the presentation times, in units of frames.

    If ``index_first`` is true, the index of the MP4 is stored before the frames, as for streaming.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    options: dict[str, Any] = {"options": {"movflags": "faststart"}} if index_first else {}
    with av.open(str(path), "w", **options) as container:
        stream = container.add_stream(codec, rate=fps, options=OPTIONS[codec])
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.time_base = Fraction(1, fps)
        for position, number in enumerate(numbers):
            frame = av.VideoFrame.from_ndarray(numbered_picture(number), format="rgb24")
            frame.pts, frame.time_base = position if times is None else times[position], Fraction(1, fps)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def write_slow_video(path: Path, interval: Fraction) -> None:
    """Write a video of 4 frames with ``interval`` seconds between two frames."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        base = Fraction(1, 1000) if interval >= 1 else Fraction(1, 10**6)
        stream.time_base = base
        for number in range(4):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 60 * number, np.uint8), format="rgb24")
            frame.pts, frame.time_base = int(number * interval / base), base
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
