"""Small videos that resemble videos of phones: with rotation metadata, uneven frame times, and HDR in 10 bits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

MATRIX_OFFSET = 40
"""Number of bytes from the end of the tag tkhd to the rotation matrix (ISO 14496-12, version 0)."""
CLOCKWISE = {90: (0, 1, -1, 0), 180: (-1, 0, 0, -1), 270: (0, -1, 1, 0)}
"""The values a, b, c, d of display matrices, by clockwise angle in degrees. A display matrix maps (x, y) to
``(a * x + c * y, b * x + d * y)``."""
TICKS = 90_000


def moving_picture(seconds: float, width: int = 64, height: int = 48) -> Picture:
    """(H, W, 3) RGB: smooth colours and a disc that moves by 20 pixels per second."""
    y, x = np.mgrid[:height, :width] + 0.5
    waves = np.stack([np.sin(x / 9), np.sin((x + y) / 12), np.cos(y / 7)], axis=2)
    picture = 120 + 60 * waves
    distance = np.hypot(x - 12 - 20 * seconds, y - 0.4 * height)
    cover = np.clip(9.5 - distance, 0, 1)[..., None]
    return np.round(picture * (1 - cover) + cover * np.array([200, 60, 40])).astype(np.uint8)


def write_phone_video(
    path: Path,
    times: Sequence[float],
    *,
    fps: Fraction | int = 30,
    clockwise: int = 0,
    transfer: str = "",
    size: tuple[int, int] = (64, 48),
) -> Path:
    """Write a video of :func:`moving_picture` with one frame at each of the ``times`` in seconds.

    The stored frames are turned, and the display matrix in the metadata turns them by ``clockwise`` degrees, so that
    players show them upright. With the transfer "HLG" or "PQ", the video is HDR in 10 bits. The white of an HDR picture
    has 203 cd/m2.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w", options={"video_track_timescale": str(TICKS)}) as container:
        stream = container.add_stream("libx265" if transfer else "libx264", rate=fps)
        width, height = size if clockwise % 180 == 0 else size[::-1]
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p10le" if transfer else "yuv420p"
        stream.options = {"crf": "8", "g": "10", "x265-params": "log-level=none"}
        stream.codec_context.time_base = Fraction(1, TICKS)
        if transfer:
            context = stream.codec_context
            context.color_trc = 18 if transfer == "HLG" else 16
            context.color_primaries = context.colorspace = 9
            context.color_range = 1
        for time in times:
            frame = make_frame(np.rot90(moving_picture(time, *size), clockwise // 90), transfer)
            frame.pts, frame.time_base = round(time * TICKS), Fraction(1, TICKS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return write_display_matrix(path, CLOCKWISE[clockwise]) if clockwise else path


def write_display_matrix(path: Path, matrix: Iterable[float]) -> Path:
    """Write the values a, b, c, d of the display matrix into the header of an MP4's first track."""
    content = bytearray(path.read_bytes())
    offset = content.index(b"tkhd") + 4 + MATRIX_OFFSET
    a, b, c, d = (round(value * (1 << 16)) for value in matrix)
    values = [a, b, 0, c, d, 0, 0, 0, 1 << 30]
    content[offset : offset + 36] = b"".join(value.to_bytes(4, "big", signed=True) for value in values)
    path.write_bytes(content)
    return path


def make_frame(picture: NDArray[Any], transfer: str) -> av.VideoFrame:
    """Convert a picture to a frame for the encoder: RGB, or YCbCr with 10 bits if a transfer function is given. Values
    above 255 are brighter than white."""
    if not transfer:
        return av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
    signal = encode_hdr(picture, transfer)
    luma = signal @ np.array([0.2627, 0.6780, 0.0593])
    blue, red = (signal[..., 2] - luma) / 1.8814, (signal[..., 0] - luma) / 1.4746
    planes = np.stack([64 + 876 * luma, 512 + 896 * blue, 512 + 896 * red])
    height, width = luma.shape
    halves = [cv2.resize(plane, (width // 2, height // 2), interpolation=cv2.INTER_AREA) for plane in planes[1:]]
    rows = np.concatenate([planes[0].ravel(), *(half.ravel() for half in halves)])
    values = np.round(rows).astype(np.uint16).reshape(-1, width)
    return av.VideoFrame.from_ndarray(values, format="yuv420p10le")


def encode_hdr(picture: NDArray[Any], transfer: str) -> NDArray[np.float64]:
    """Convert an sRGB picture, whose white has 203 cd/m2, to an HDR signal (H, W, 3) in [0, 1] with BT.2020
    primaries."""
    value = picture / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    to_2020 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
    nits = 203 * linear @ to_2020.T
    if transfer == "PQ":
        power = (nits / 10_000) ** (1305 / 8192)
        return np.asarray(((3424 / 4096 + 2413 / 128 * power) / (1 + 2392 / 128 * power)) ** (2523 / 32))
    display = nits / 1000
    luminance = display @ np.array([0.2627, 0.6780, 0.0593])
    scene = display * np.maximum(luminance, 1e-9)[..., None] ** (1 / 1.2 - 1)
    low = np.sqrt(3 * scene)
    high = 0.17883277 * np.log(np.maximum(12 * scene - 0.28466892, 1e-9)) + 0.55991073
    return np.asarray(np.where(scene <= 1 / 12, low, high))
