"""Mattes before a screen of one colour, which may be lit unevenly and bear shadows.

Colours are taken apart into brightness Y and chroma (Cb, Cr). Light scales both alike, so that a pixel's chroma is
held against the screen's at the pixel's own brightness. The subject is what differs from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.errors import UserError
from fourd.matting.edges import BAND, cleaned, softened, unmixed

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

DARKEST = 0.4
BRIGHTEST = 1.4
"""Light on the screen, of its median: beyond these a pixel's chroma need not follow its brightness."""
LEAST_CHROMA = 28.0
"""Of 128: of a weaker colour, noise and reflections on the subject are not told from the screen."""
LEAST_SHARE = 0.5
"""Of the pictures' borders, that must show one colour."""
BORDER = 0.08
"""Of a picture's sides."""
HUES = 72
NEAR_HUE = 15.0
"""Degrees."""
WIDEST_SPREAD = 0.3
USUAL_SPREAD = 0.15
SUBJECT_DISTANCE = 0.4
"""Least distance of the subject; 0 = the screen, 1 = grey: an edge's pixel that shows a little less than half of it."""
SPREADS = 1.6
"""The screen's spread, times this, is no subject yet."""
MOST_SAMPLES = 20_000
"""Border pixels a picture."""


@dataclass(frozen=True)
class ScreenColour:
    """A screen's colour.

    Attributes:
        rgb: 0 to 255, in its usual light.
        spread: distance (see :func:`distance`) that all but a hundredth of its pixels keep within.
    """

    rgb: tuple[float, float, float]
    spread: float = USUAL_SPREAD


def find_screen(pictures: Sequence[Picture]) -> ScreenColour:
    """The colour that most of the pictures' borders show, in whatever light.

    Args:
        pictures: (H, W, 3) uint8, at least one; of several cameras or moments before the same screen.

    Raises:
        UserError: when no colour with enough chroma fills half of the borders.
    """
    border = np.concatenate([_border(picture) for picture in pictures])
    _, chroma = _taken_apart(border)
    strength = np.linalg.norm(chroma, axis=-1)
    coloured = strength > 0.5 * LEAST_CHROMA
    hue = np.degrees(np.arctan2(chroma[:, 1], chroma[:, 0])) % 360
    counts = np.bincount((hue[coloured] * HUES / 360).astype(int) % HUES, minlength=HUES)
    commonest = (np.argmax(counts + np.roll(counts, 1) + np.roll(counts, -1)) + 0.5) * 360 / HUES
    near = coloured & (np.abs((hue - commonest + 180) % 360 - 180) < NEAR_HUE)
    share = float(near.mean())
    if share < LEAST_SHARE:
        raise _no_screen(f"borders of which at most {100 * share:.0f} % share one")
    rgb = np.median(border[near], axis=0)
    screen = ScreenColour((float(rgb[0]), float(rgb[1]), float(rgb[2])))
    if _chroma_of(screen) < LEAST_CHROMA:
        raise _no_screen(f"{_named(screen)}, which is nearly grey")
    spread = float(np.quantile(distance(border[near], screen), 0.99))
    if spread > WIDEST_SPREAD:
        raise _no_screen(f"borders of many shades about {_named(screen)}")
    return ScreenColour(screen.rgb, spread)


def given_screen(text: str) -> ScreenColour:
    """The screen of an argument ``R,G,B``, three whole numbers of 0 to 255.

    Raises:
        UserError: when it is something else, or nearly grey.
    """
    parts = text.split(",")
    if len(parts) != 3 or not all(part.strip().isdecimal() and int(part) <= 255 for part in parts):
        raise UserError(f"--screen: expected R,G,B of 0 to 255 each, such as 0,177,64, got '{text}'")
    red, green, blue = (float(part) for part in parts)
    screen = ScreenColour((red, green, blue))
    if _chroma_of(screen) < LEAST_CHROMA:
        raise UserError(
            f"--screen: expected a colour such as 0,177,64, got {text}, which is nearly grey; "
            "use another --method before a grey, white or black background"
        )
    return screen


def chroma_matte(rgb: Picture, screen: ScreenColour) -> Picture:
    """(H, W) uint8 matte, 255 = subject, of a picture (H, W, 3) uint8 before the screen.

    Small parts and holes are removed; the edge is soft and follows the picture's.
    """
    from_screen = cv2.GaussianBlur(distance(rgb, screen), (3, 3), 0.7)
    least = max(SUBJECT_DISTANCE, SPREADS * screen.spread)
    subject = cleaned((from_screen > least).astype(np.uint8))
    radius = max(2, round(BAND * max(rgb.shape[:2])))
    alpha = softened(subject, np.ascontiguousarray(rgb), radius)
    return np.asarray(255 * unmixed(rgb, subject, alpha, radius) + 0.5, np.uint8)


def distance(rgb: Picture, screen: ScreenColour) -> Floats:
    """(...) float32 of colours (..., 3): 0 for the screen's in any light, 1 for a grey, more for opposite hues."""
    luma, chroma = _taken_apart(rgb)
    screen_luma, screen_chroma = _taken_apart(np.array(screen.rgb, np.float32))
    light = np.clip(luma / screen_luma, DARKEST, BRIGHTEST)
    away = np.linalg.norm(chroma - light[..., None] * screen_chroma, axis=-1)
    return np.asarray(away / (light * np.linalg.norm(screen_chroma)), np.float32)


def _taken_apart(rgb: NDArray[np.generic]) -> tuple[Floats, Floats]:
    """Y (...) of 0 to 255, and Cb and Cr (..., 2) about 0, of colours (..., 3) (ITU-R BT.601)."""
    red, green, blue = np.moveaxis(rgb.astype(np.float32), -1, 0)
    luma = np.float32(0.299) * red + np.float32(0.587) * green + np.float32(0.114) * blue
    return luma, np.stack([np.float32(0.564) * (blue - luma), np.float32(0.713) * (red - luma)], axis=-1)


def _border(picture: Picture) -> Picture:
    """Colours (N, 3) of the picture's border, at most MOST_SAMPLES of them, evenly chosen."""
    height, width = picture.shape[:2]
    inner = np.zeros((height, width), bool)
    margin = max(1, round(BORDER * min(height, width)))
    inner[margin:-margin, margin:-margin] = True
    colours = picture[~inner]
    return colours[:: max(1, len(colours) // MOST_SAMPLES)]


def _chroma_of(screen: ScreenColour) -> float:
    return float(np.linalg.norm(_taken_apart(np.array(screen.rgb))[1]))


def _named(screen: ScreenColour) -> str:
    return ",".join(f"{value:.0f}" for value in screen.rgb)


def _no_screen(got: str) -> UserError:
    return UserError(
        f"the pictures: expected a screen of one colour, got {got}; name it with --screen R,G,B or use another --method"
    )
