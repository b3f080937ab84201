"""Encodes images for compositors: PNG files of 16 bits, and EXR files of 32-bit floats."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.files import write_bytes_atomically

ImageFormat = Literal["png", "exr"]
_WHOLE = 65535


def write_channel(path: Path, values: NDArray[np.floating]) -> None:
    """Write an image (H, W) or (H, W, 3) to a file atomically, as PNG (16 bits) or EXR depending on the suffix. Values
    of a PNG are multiplied by 65535, rounded and clamped."""
    content = _encode_exr(values) if path.suffix == ".exr" else _encode_png(values)
    write_bytes_atomically(path, content)


def to_linear(rgb: NDArray[np.floating], alpha: NDArray[np.floating] | None = None) -> NDArray[np.float32]:
    """Convert colours (H, W, 3) from sRGB to linear light, as EXR files have them. If the colours are on black, with
    the opacity ``alpha`` (H, W), they are divided by it before and multiplied by it after."""
    opacity = np.ones_like(rgb[..., :1]) if alpha is None else alpha[..., None]
    straight = np.divide(rgb, opacity, out=np.zeros_like(rgb), where=opacity > 1e-6).clip(0, 1)
    linear = np.where(straight <= 0.04045, straight / 12.92, ((straight.clip(0.04045) + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear * opacity, np.float32)


def _encode_png(values: NDArray[np.floating]) -> bytes:
    image = np.round(np.clip(values, 0, 1) * np.float32(_WHOLE)).astype(np.uint16)
    _, content = cv2.imencode(".png", image if image.ndim == 2 else image[..., ::-1])
    return content.tobytes()


def _encode_exr(values: NDArray[np.floating]) -> bytes:
    """FFmpeg writes the channels R, G and B, or Y, in scan lines with ZIP compression, without loss."""
    image = np.ascontiguousarray(values, np.float32)
    kind = "grayf32le" if image.ndim == 2 else "gbrpf32le"
    encoder: Any = av.CodecContext.create("exr", "w")
    (encoder.height, encoder.width), encoder.pix_fmt = image.shape[:2], kind
    encoder.time_base = Fraction(1)
    encoder.options = {"compression": "zip16", "format": "float"}
    frame = av.VideoFrame.from_ndarray(image, format=kind)
    frame.pts = 0
    return b"".join(bytes(packet) for each in (frame, None) for packet in encoder.encode(each))
