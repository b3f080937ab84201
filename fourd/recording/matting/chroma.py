"""Chroma keying: mattes in front of a screen of one colour, robust to uneven light and shadows.

Colours are split into luma Y and chroma (Cb, Cr). Illumination scales luma and chroma by the same factor, so the
screen's chroma is scaled to each pixel's luma before it is compared with the pixel's chroma. Pixels whose chroma
differs from the screen's chroma are the subject.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.recording.matting.edges import BAND, estimate_edge_alpha, remove_small_regions

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

DARKEST = 0.4
BRIGHTEST = 1.4
"""Before the screen's chroma is scaled to a pixel's luma, the ratio of the pixel's luma to the screen's luma is clamped
to the range from DARKEST to BRIGHTEST."""
MIN_CHROMA = 28.0
"""Minimum chroma magnitude of a screen's colour. The largest possible magnitude is 128.

Screen colours with less chroma cannot be separated from noise and from reflections on the subject.
"""
MIN_BORDER_SHARE = 0.5
"""At least this fraction of the images' border pixels must have the screen's hue."""
BORDER = 0.08
"""Width of the border as a fraction of the image's shorter side."""
HUE_BINS = 72
HUE_TOLERANCE_DEG = 15.0
MAX_SPREAD = 0.3
DEFAULT_SPREAD = 0.15
SUBJECT_DISTANCE = 0.4
"""A pixel can belong to the subject only if its :func:`screen_distance` is at least this value
(0 is the screen, 1 is grey).

The value is below 0.5, so that the matte includes edge pixels of which the subject covers slightly less than one half.
"""
SPREAD_FACTOR = 1.6
"""A pixel can belong to the subject only if its :func:`screen_distance` is at least this multiple of the screen's
spread, the 99th percentile of the screen_distance of the screen's own pixels."""
MAX_SAMPLES = 20_000
"""Approximate number of border pixels sampled per image."""


@dataclass(frozen=True)
class ScreenColour:
    """Colour of a screen.

    Attributes:
        rgb: median colour, 0 to 255.
        spread: 99th percentile of the :func:`screen_distance` of the screen's pixels.
    """

    rgb: tuple[float, float, float]
    spread: float = DEFAULT_SPREAD


def find_screen(pictures: Sequence[Picture]) -> ScreenColour:
    """Estimate the screen's colour from the border pixels of images.

    Args:
        pictures: images (H, W, 3) uint8 of the same screen, at least one.

    Raises:
        UserError: if no single saturated hue covers half of the border pixels, or if the shades of the screen vary too
            much.
    """
    border = np.concatenate([_border(picture) for picture in pictures])
    _, chroma = _luma_chroma(border)
    strength = np.linalg.norm(chroma, axis=-1)
    coloured = strength > 0.5 * MIN_CHROMA
    hue = np.degrees(np.arctan2(chroma[:, 1], chroma[:, 0])) % 360
    counts = np.bincount((hue[coloured] * HUE_BINS / 360).astype(int) % HUE_BINS, minlength=HUE_BINS)
    dominant = (np.argmax(counts + np.roll(counts, 1) + np.roll(counts, -1)) + 0.5) * 360 / HUE_BINS
    is_screen = coloured & (np.abs((hue - dominant + 180) % 360 - 180) < HUE_TOLERANCE_DEG)
    share = float(is_screen.mean())
    if share < MIN_BORDER_SHARE:
        raise _screen_error(f"images with the same hue in at most {100 * share:.0f} % of their border pixels")
    rgb = np.median(border[is_screen], axis=0)
    screen = ScreenColour((float(rgb[0]), float(rgb[1]), float(rgb[2])))
    if _chroma_of(screen) < MIN_CHROMA:
        raise _screen_error(f"{_format_rgb(screen)}, which is nearly grey")
    spread = float(np.quantile(screen_distance(border[is_screen], screen), 0.99))
    if spread > MAX_SPREAD:
        raise _screen_error(f"images whose border pixels have very different shades of {_format_rgb(screen)}")
    return ScreenColour(screen.rgb, spread)


def parse_screen(text: str) -> ScreenColour:
    """Parse a screen colour ``R,G,B``: three integers from 0 to 255.

    Raises:
        UserError: if the text does not have this format, or the colour is nearly grey.
    """
    parts = text.split(",")
    if len(parts) != 3 or not all(part.strip().isdecimal() and int(part) <= 255 for part in parts):
        raise UserError(f"--screen: expected R,G,B of 0 to 255 each, such as 0,177,64, got '{text}'")
    red, green, blue = (float(part) for part in parts)
    screen = ScreenColour((red, green, blue))
    if _chroma_of(screen) < MIN_CHROMA:
        raise UserError(
            f"--screen: expected a colour such as 0,177,64, got {text}, which is nearly grey; "
            "use another --method for a grey, white or black background"
        )
    return screen


def chroma_matte(rgb: Picture, screen: ScreenColour) -> Picture:
    """Compute a matte (H, W) uint8, 255 = subject, from an image (H, W, 3) uint8 whose background is the screen.

    Small regions and small holes are removed. The matte's edge is soft and follows the image's edges.
    """
    from_screen = cv2.GaussianBlur(screen_distance(rgb, screen), (3, 3), 0.7)
    threshold = max(SUBJECT_DISTANCE, SPREAD_FACTOR * screen.spread)
    subject = remove_small_regions((from_screen > threshold).astype(np.uint8))
    radius = max(2, round(BAND * max(rgb.shape[:2])))
    return np.asarray(255 * estimate_edge_alpha(rgb, subject, radius) + 0.5, np.uint8)


def screen_distance(rgb: Picture, screen: ScreenColour) -> Floats:
    """Return the chroma distance, independent of illumination, between each colour in ``rgb`` and the screen.

    The distance is 0 for the screen's colour, 1 for grey, and above 1 for opposite hues. For an image
    (H, W, 3), the distances are an array (H, W) float32.
    """
    luma, chroma = _luma_chroma(rgb)
    screen_luma, screen_chroma = _luma_chroma(np.array(screen.rgb, np.float32))
    light = np.clip(luma / screen_luma, DARKEST, BRIGHTEST)
    difference = np.linalg.norm(chroma - light[..., None] * screen_chroma, axis=-1)
    return np.asarray(difference / (light * np.linalg.norm(screen_chroma)), np.float32)


def _luma_chroma(rgb: NDArray[np.generic]) -> tuple[Floats, Floats]:
    """Convert RGB colours to luma Y from 0 to 255 and chroma (Cb, Cr) around 0 (ITU-R BT.601).

    The last axis of ``rgb`` has 3 elements, the last axis of the chroma has 2, and the luma lacks the last axis.
    """
    red, green, blue = np.moveaxis(rgb.astype(np.float32), -1, 0)
    luma = np.float32(0.299) * red + np.float32(0.587) * green + np.float32(0.114) * blue
    return luma, np.stack([np.float32(0.564) * (blue - luma), np.float32(0.713) * (red - luma)], axis=-1)


def _border(picture: Picture) -> Picture:
    """Return the colours (N, 3) of the image's border pixels, evenly subsampled to about MAX_SAMPLES."""
    height, width = picture.shape[:2]
    inner = np.zeros((height, width), bool)
    margin = max(1, round(BORDER * min(height, width)))
    inner[margin:-margin, margin:-margin] = True
    colours = picture[~inner]
    return colours[:: max(1, len(colours) // MAX_SAMPLES)]


def _chroma_of(screen: ScreenColour) -> float:
    return float(np.linalg.norm(_luma_chroma(np.array(screen.rgb))[1]))


def _format_rgb(screen: ScreenColour) -> str:
    return ",".join(f"{value:.0f}" for value in screen.rgb)


def _screen_error(got: str) -> UserError:
    return UserError(
        f"the images: expected a screen of one colour, got {got}; "
        "set the colour with --screen R,G,B or use another --method"
    )
