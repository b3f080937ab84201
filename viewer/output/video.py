"""Writes MP4 files (H.264) image by image."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from fourd.errors import UserError
from fourd.files import atomic_path, remove_unfinished_file

# The value 1 stands for BT.709 as the matrix, the primaries and the transfer function (ITU-T H.273). As FFmpeg's
# color_range, it stands for limited range.
_BT709 = 1
_ENCODERS = ("libx264", "libopenh264", "h264_videotoolbox", "h264")


def write_video(path: Path | str, images: Iterable[NDArray[Any]], fps: float, *, quality: int = 18) -> int:
    """Write images as an MP4 (H.264, yuv420p, BT.709), which every player opens.

    Args:
        path: the file, which is written atomically. If ``images`` raises an exception, no file is written.
        images: RGB images (H, W, 3) of one size, as uint8 or as float in [0, 1]. They are read one by one, so
            ``images`` can be a generator, and memory use does not grow with their number. If a side is odd, the last
            row or column is repeated, because yuv420p needs even sides.
        fps: images per second, above 0.
        quality: constant rate factor (CRF) of x264, from 0 (lossless) to 51. A smaller CRF gives better quality and a
            larger file. Other encoders ignore it.

    Returns:
        The number of images written.

    Raises:
        UserError: when there is no H.264 encoder, or when ``images`` is empty.
        ValueError: when an image does not have the shape of the first image.
    """
    path = Path(path)
    if not fps > 0:
        raise ValueError(f"fps: expected more than 0, got {fps}")
    encoder = _find_encoder(path)
    remove_unfinished_file(path)
    count = 0
    stream: Any = None
    shape: tuple[int, ...] = ()
    with (
        atomic_path(path) as temporary,
        av.open(str(temporary), "w", format="mp4", options={"movflags": "+faststart"}) as container,
    ):
        for image in images:
            if stream is None:
                shape = image.shape
                stream = _add_stream(container, encoder, shape, fps, quality)
            if image.shape != shape:
                raise ValueError(f"images: expected {shape} like the first image, got {image.shape} at index {count}")
            _encode(container, stream, _to_yuv(image))
            count += 1
        if stream is None:
            raise UserError(f"{path}: expected at least one image for a video, got none")
        _encode(container, stream, None)
    return count


def _find_encoder(path: Path) -> str:
    for name in _ENCODERS:
        if name in av.codecs_available:
            try:
                av.Codec(name, "w")
            except ValueError:
                continue
            return name
    raise UserError(
        f"{path}: expected FFmpeg with an H.264 encoder in PyAV, got none; "
        "pip install --force-reinstall --only-binary=:all: av, or give a folder as output to get PNG images"
    )


def _add_stream(container: Any, encoder: str, shape: tuple[int, ...], fps: float, quality: int) -> Any:
    if len(shape) != 3 or shape[2] != 3 or min(shape) < 1:
        raise ValueError(f"images: expected (H, W, 3), got {shape}")
    options = {"crf": str(quality), "preset": "medium"} if encoder == "libx264" else {}
    stream = container.add_stream(encoder, rate=Fraction(fps).limit_denominator(100_000), options=options)
    stream.height, stream.width = (side + side % 2 for side in shape[:2])
    stream.pix_fmt = "yuv420p"
    context = stream.codec_context
    context.color_range = context.colorspace = context.color_primaries = context.color_trc = _BT709
    return stream


def _to_yuv(image: NDArray[Any]) -> Any:
    if image.dtype != np.uint8:
        image = np.round(np.nan_to_num(np.clip(image, 0, 1)) * 255).astype(np.uint8)
    height, width = image.shape[:2]
    if height % 2 or width % 2:
        image = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
    return frame.reformat(format="yuv420p", dst_colorspace="ITU709")


def _encode(container: Any, stream: Any, frame: Any) -> None:
    for packet in stream.encode(frame):
        container.mux(packet)
