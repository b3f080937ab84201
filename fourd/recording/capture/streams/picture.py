"""Conversion of decoded video frames to upright sRGB images: rotation, size, transparency, and tone mapping of HDR.

HDR signals (ITU-R BT.2100) are converted in these steps:

1. HLG: the inverse OETF gives scene light E. The OOTF with the system gamma 1.2 and a peak of 1000 cd/m2 gives display
   light ``1000 * Y^0.2 * E``. Y is the luminance of E, and 0.2 is the gamma minus 1. PQ: the EOTF (SMPTE ST 2084)
   gives display light.
2. Display light is divided by 203 cd/m2, the reference white of ITU-R BT.2408.
3. The primaries are converted from BT.2020 to BT.709. Negative values are set to 0.
4. Let m be the maximum of red, green and blue. The colour is scaled by f(m) / m. Up to the knee 0.85, f(m) = m, so
   colours do not change. Above the knee, ``f(m) = 0.85 + 0.15 * t / (1 + t)`` with ``t = (m - 0.85) / 0.15``.
5. The transfer function of sRGB (IEC 61966-2-1) is applied.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from typing import Any

import av
import numpy as np
from av.video.reformatter import ColorRange, Colorspace, ColorTrc
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Floats = NDArray[np.float32]

HLG, PQ = "HLG", "PQ"
TRANSFERS = {int(ColorTrc.ARIB_STD_B67): HLG, int(ColorTrc.SMPTE2084): PQ}
REFERENCE_WHITE = 203.0
"""Luminance in cd/m2 of diffuse white in HDR video (ITU-R BT.2408).

Linear colours have the value 1 at this luminance.
"""
HLG_PEAK = 1000.0
HLG_GAMMA = 1.2
KNEE = 0.85
MAX_TURN_ERROR = 1
"""Maximum deviation in degrees of a display matrix's angle from a multiple of 90 degrees."""
LEVELS = 1 << 12
"""Number of entries of the tables of transfer functions.

The number is sufficient for HDR video, which has 10 or 12 bits.
"""
BT2020_LUMINANCE = (0.2627, 0.6780, 0.0593)
BT709_FROM_BT2020 = (
    (1.660491, -0.587641, -0.072850),
    (-0.124550, 1.132900, -0.008349),
    (-0.018151, -0.100579, 1.118730),
)
"""Matrix that converts linear light from BT.2020 primaries to BT.709 primaries (inverse of ITU-R BT.2087, table 4)."""


def transfer_of(frame: av.VideoFrame) -> str:
    """Return the HDR transfer function of a frame: "HLG", "PQ", or "" if the frame is not HDR."""
    return TRANSFERS.get(int(frame.color_trc or 0), "")


def turn_of(frame: av.VideoFrame) -> int | None:
    """Return the angle in degrees (0, 90, 180 or 270) by which a frame must be turned counter-clockwise to be upright.

    Returns None if the frame's display matrix mirrors the frame or turns it by another angle.
    """
    side_data: Any = frame.side_data  # PyAV accepts this key, but its type annotations do not declare it
    if "DISPLAYMATRIX" in side_data:
        a, b, _, c, d = np.frombuffer(side_data["DISPLAYMATRIX"], np.int32)[:5].tolist()
        if a * d - b * c < 0:
            return None
    turn = round(frame.rotation / 90) * 90
    return turn % 360 if abs(turn - frame.rotation) <= MAX_TURN_ERROR else None


def shown_size(width: int, height: int, aspect: Fraction) -> tuple[int, int]:
    """Return the width and height in pixels of a stored frame that is stretched to square pixels.

    Wide pixels (``aspect`` above 1) are stretched in width, and tall pixels in height, so that no detail is lost.
    """
    if aspect > 1:
        return max(1, round(width * aspect)), height
    return width, max(1, round(height / aspect))


def has_alpha(frame: av.VideoFrame) -> bool:
    """Return whether a frame can have transparent pixels."""
    return frame.format.has_palette or any(component.is_alpha for component in frame.format.components)


def to_rgb(frame: av.VideoFrame, turn: int, transfer: str, size: tuple[int, int]) -> Picture:
    """Convert a decoded frame to an upright sRGB image (H, W, 3) uint8. Transparent pixels become black.

    Args:
        frame: the decoded frame.
        turn: angle in degrees by which the image is turned counter-clockwise: 0, 90, 180 or 270.
        transfer: HDR transfer function of the frame, see :func:`transfer_of`.
        size: width and height in pixels before the turn. The frame is stretched or scaled down to this size.
    """
    if transfer:
        rgb = _tone_map(_hdr_signal(frame), transfer)
    elif has_alpha(frame):
        rgba = np.asarray(frame.to_ndarray(format="rgba"), np.uint16)
        rgb = ((rgba[..., :3] * rgba[..., 3:] + 127) // 255).astype(np.uint8)
    else:
        rgb = np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
    if rgb.shape[1::-1] != size:
        import cv2  # Only here, so that a video is described without the import of OpenCV.

        is_smaller = size[0] <= rgb.shape[1] and size[1] <= rgb.shape[0]
        rgb = np.asarray(
            cv2.resize(rgb, size, interpolation=cv2.INTER_AREA if is_smaller else cv2.INTER_CUBIC), np.uint8
        )
    return np.ascontiguousarray(np.rot90(rgb, turn // 90), np.uint8)


def reduced_size(width: int, height: int, scale: float) -> tuple[int, int]:
    """Return the width and height times ``scale``, rounded to whole pixels like
    :meth:`fourd.base.cameras.Camera.rescale`."""
    return max(1, round(width * scale)), max(1, round(height * scale))


def _hdr_signal(frame: av.VideoFrame) -> Floats:
    """Convert the YCbCr signal of an HDR frame to a non-linear RGB signal (H, W, 3) in [0, 1] (ITU-R BT.2100, table 6).

    libswscale resamples the chroma planes and converts the bit depth. This function applies the YCbCr matrix in
    floating point.
    """
    planes = frame.reformat(format="yuv444p16le").to_ndarray(format="yuv444p16le").astype(np.float32)
    y, cb, cr = planes if planes.shape[0] == 3 else np.moveaxis(planes, 2, 0)
    if int(frame.color_range or 0) == int(ColorRange.JPEG):
        y, cb, cr = y / 65535, cb / 65535 - 0.5, cr / 65535 - 0.5
    else:
        y, cb, cr = (y / 256 - 16) / 219, (cb / 256 - 128) / 224, (cr / 256 - 128) / 224
    red_weight, green_weight, blue_weight = BT2020_LUMINANCE
    if int(frame.colorspace or 0) == int(Colorspace.ITU709):
        red_weight, green_weight, blue_weight = 0.2126, 0.7152, 0.0722
    red = y + 2 * (1 - red_weight) * cr
    blue = y + 2 * (1 - blue_weight) * cb
    green = (y - red_weight * red - blue_weight * blue) / green_weight
    return np.stack([red, green, blue], axis=2).clip(0, 1)


def _tone_map(signal: Floats, transfer: str) -> Picture:
    """Convert a non-linear HDR signal (H, W, 3) in [0, 1] with BT.2020 primaries to sRGB (H, W, 3) uint8."""
    import cv2

    light, encoded, hlg_gain = _tables(transfer)
    linear = light[np.round(signal * (LEVELS - 1)).astype(np.int32)]
    if transfer == HLG:
        luminance = linear @ np.array(BT2020_LUMINANCE, np.float32)
        linear = linear * hlg_gain[np.round(luminance * (LEVELS - 1)).astype(np.int32)][..., None]
    display = np.maximum(cv2.transform(linear, np.array(BT709_FROM_BT2020, np.float32)), 0)
    largest = np.maximum(display.max(axis=2, keepdims=True), 1e-6)
    above = np.maximum(largest - KNEE, 0) / (1 - KNEE)
    mapped = np.minimum(largest, KNEE) + (1 - KNEE) * above / (1 + above)
    display = display * (mapped / largest)
    return np.asarray(encoded[np.round(np.sqrt(display.clip(0, 1)) * (LEVELS - 1)).astype(np.int32)])


@cache
def _tables(transfer: str) -> tuple[Floats, Picture, Floats]:
    """Return lookup tables of an HDR transfer function and of sRGB.

    Returns:
        Three tables. The first table has the linear light for each signal value, in units of the reference white (for
        HLG: scene light in [0, 1]). The second table has the 8-bit sRGB values, indexed by the square root of linear
        light. The third table is for HLG: for each luminance, it has the factor by which the OOTF multiplies scene
        light to get display light.
    """
    steps = np.linspace(0, 1, LEVELS)
    if transfer == HLG:
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        light = np.where(steps <= 0.5, steps**2 / 3, (np.exp((steps - c) / a) + b) / 12)
    else:
        m1, m2, c1, c2, c3 = 1305 / 8192, 2523 / 32, 107 / 128, 2413 / 128, 2392 / 128
        power = steps ** (1 / m2)
        light = 10_000 / REFERENCE_WHITE * (np.maximum(power - c1, 0) / (c2 - c3 * power)) ** (1 / m1)
    gain = HLG_PEAK / REFERENCE_WHITE * steps ** (HLG_GAMMA - 1)
    linear = steps**2
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return light.astype(np.float32), np.round(255 * srgb).astype(np.uint8), gain.astype(np.float32)
