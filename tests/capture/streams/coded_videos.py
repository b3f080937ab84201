"""Small videos of all codecs and containers. Every frame shows its own number, twice, so that a test detects both a
wrong frame and a frame that is decoded from wrong references."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.packet import Packet
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

SIZE = 64
BLOCK = 16
BITS = 8
GARBAGE = -1
FPS = 25
TICKS = 90_000

CONTAINERS = ("mp4", "mov", "mkv", "webm", "avi", "ts", "mts", "m2ts", "mpg")
CODECS = ("h264", "hevc", "vp9", "av1", "mpeg2video", "mjpeg", "prores")
ENCODERS = {
    "h264": "libx264",
    "hevc": "libx265",
    "vp9": "libvpx-vp9",
    "av1": "libsvtav1",
    "mpeg2video": "mpeg2video",
    "mjpeg": "mjpeg",
    "prores": "prores_ks",
}
TRANSPORT = {"h264", "hevc", "mpeg2video"}
STORED = {
    "mp4": {"h264", "hevc", "vp9", "av1", "mpeg2video", "mjpeg"},
    "mov": {"h264", "hevc", "mpeg2video", "mjpeg", "prores"},
    "mkv": set(CODECS),
    "webm": {"vp9", "av1"},
    "avi": {"h264", "vp9", "av1", "mpeg2video", "mjpeg"},
    "ts": TRANSPORT,
    "mts": TRANSPORT,
    "m2ts": TRANSPORT,
    "mpg": {"h264", "mpeg2video"},
}
"""The codecs that FFmpeg can write into each container."""
PAIRS = [(container, codec) for container in CONTAINERS for codec in CODECS if codec in STORED[container]]


@dataclass(frozen=True)
class Coding:
    """How a video is coded.

    Attributes:
        interval: number of frames from one keyframe to the next.
        b_frames: number of frames between two reference frames that refer to both.
        is_open: whether frames that are shown before a keyframe and stored after it refer to frames before the
            keyframe.
        has_refresh: whether there are no keyframes after the first; the picture is refreshed in strips instead.
    """

    interval: int = 12
    b_frames: int = 2
    is_open: bool = False
    has_refresh: bool = False


def options_of(codec: str, coding: Coding) -> dict[str, str]:
    """The options of the encoder of a codec."""
    interval, b_frames = coding.interval, coding.b_frames
    shared = {"g": str(interval), "bf": str(b_frames)}
    if codec == "h264":
        more = f":open-gop={int(coding.is_open)}:intra-refresh={int(coding.has_refresh)}"
        params = f"b-adapt=0:scenecut=0:threads=1:keyint={interval}:min-keyint={interval}:bframes={b_frames}{more}"
        return shared | {"crf": "15", "preset": "ultrafast", "x264-params": params}
    if codec == "hevc":
        params = f"b-adapt=0:scenecut=0:keyint={interval}:min-keyint={interval}:bframes={b_frames}"
        params += f":open-gop={int(coding.is_open)}:pools=none:frame-threads=1:log-level=none"
        return {"crf": "15", "preset": "ultrafast", "x265-params": params}
    if codec == "vp9":
        return {"g": str(interval), "deadline": "realtime", "cpu-used": "8", "crf": "20", "b": "0"} | (
            {"auto-alt-ref": "1", "lag-in-frames": "10"} if b_frames else {}
        )
    if codec == "av1":
        prediction = 2 if b_frames else 1
        params = f"keyint={interval}:pred-struct={prediction}:lp=1:irefresh-type={1 if coding.is_open else 2}"
        return {"preset": "8", "crf": "5", "svtav1-params": params}
    if codec == "mpeg2video":
        flags = {} if coding.is_open else {"flags": "+cgop", "sc_threshold": "1000000000"}
        return shared | {"b": "2000000"} | flags
    return {}


def numbered_picture(number: int) -> Picture:
    """A picture, (64, 64, 3) RGB, that shows a number: 8 blocks are its bits, and 8 blocks the inverted bits."""
    bits = (number >> np.arange(BITS)) & 1
    blocks = np.where(np.concatenate([bits, 1 - bits]), 210, 40).reshape(SIZE // BLOCK, SIZE // BLOCK)
    grey = np.kron(blocks, np.ones((BLOCK, BLOCK)))
    return np.stack([grey] * 3, axis=2).astype(np.uint8)


def number_of(picture: Picture) -> int:
    """The number that a decoded frame shows, or GARBAGE if its blocks contradict each other."""
    blocks = picture[..., 1].reshape(SIZE // BLOCK, BLOCK, SIZE // BLOCK, BLOCK)[:, 3:-3, :, 3:-3]
    means = blocks.mean(axis=(1, 3)).ravel()
    bits, inverted = means[:BITS] > 125, means[BITS:] > 125
    if (bits == inverted).any() or np.abs(means - 125).min() < 30:
        return GARBAGE
    return int((bits << np.arange(BITS)).sum())


def write(
    path: Path,
    codec: str,
    numbers: Sequence[int],
    coding: Coding = Coding(),
    *,
    times: Sequence[int] | None = None,
    base: Fraction = Fraction(1, FPS),
    pix_fmt: str | None = None,
    options: dict[str, str] | None = None,
    prepare: Callable[[Any], None] | None = None,
    make: Callable[[int], Any] = numbered_picture,
) -> Path:
    """Write a video of numbered pictures; the suffix of ``path`` selects the container.

    ``times`` replaces the presentation times, in units of ``base`` seconds. ``options`` are those of the container,
    and ``prepare`` can change the stream. ``make`` returns the picture or frame for a number.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_output(path, options) as container:
        stream: Any = container.add_stream(ENCODERS.get(codec, codec), rate=FPS)
        first = make(numbers[0])
        stream.height, stream.width = first.shape[:2] if isinstance(first, np.ndarray) else (first.height, first.width)
        formats = {"mjpeg": "yuvj420p", "prores": "yuv422p10le"}
        stream.pix_fmt = pix_fmt or formats.get(codec, "yuv420p")
        stream.options = options_of(codec, coding)
        stream.codec_context.time_base = base
        stream.codec_context.thread_count = 1
        if prepare is not None:
            prepare(stream)
        for position, number in enumerate(numbers):
            picture = make(number)
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24") if isinstance(picture, np.ndarray) else picture
            frame.pts, frame.time_base = position if times is None else times[position], base
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def copy_packets(
    source: Path,
    target: Path,
    change: Callable[[list[Packet]], list[Packet]],
    *,
    options: dict[str, str] | None = None,
    prepare: Callable[[Any], None] | None = None,
) -> Path:
    """Copy the packets of a video into another container, after ``change`` has changed their list."""
    with av.open(str(source)) as reading, open_output(target, options) as writing:
        stream = writing.add_stream_from_template(reading.streams.video[0])
        if prepare is not None:
            prepare(stream)
        for packet in change([packet for packet in reading.demux(video=0) if packet.size]):
            packet.stream = stream
            writing.mux(packet)
    return target


def open_output(path: Path, options: dict[str, str] | None = None) -> Any:
    """Open a container for writing. Its suffix selects the format, also that of MPEG streams."""
    name = {".mts": "mpegts", ".m2ts": "mpegts", ".ts": "mpegts", ".mpg": "vob"}.get(path.suffix)
    more = {"mpegts_m2ts_mode": "1"} if path.suffix == ".m2ts" else {}
    return av.open(str(path), "w", format=name, options=more | (options or {}))
