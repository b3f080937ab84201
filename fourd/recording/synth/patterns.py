"""Surface colours of the parts of the synthetic figure. The colours are functions of the position in the part's own
coordinates, so that they move with the part."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

Kind = Literal["stripes", "hoops", "checks", "dots", "noise", "plain"]


@dataclass(frozen=True)
class Pattern:
    """A pattern: two colours, and a rule by which they are mixed.

    Attributes:
        kind: kind of pattern. Stripes run at an angle to the part's axis. Hoops are perpendicular to the axis. Checks
            and dots repeat along and around the axis. Noise varies smoothly. A plain pattern has only the first colour.
        first: first colour, RGB in [0, 1].
        second: second colour, RGB in [0, 1].
        period: period along the part's axis, in metres.
        around: number of repetitions around the axis for checks and dots.
        phase: shift of the pattern in radians.
        badge: radius, in metres, of a coloured disc on the front and on the back of the part; 0 means no disc.
        badge_height: position of the disc's centre along the part's axis, in metres.
        badge_colour: colour of the disc, RGB in [0, 1].
    """

    kind: Kind
    first: Colour
    second: Colour
    period: float = 0.1
    around: int = 6
    phase: float = 0.0
    badge: float = 0.0
    badge_height: float = 0.0
    badge_colour: Colour = (1.0, 1.0, 1.0)

    def colours(self, xyz: Array) -> Array:
        """Return the colours (N, 3), RGB in [0, 1], at positions ``xyz`` (N, 3).

        The positions are in metres and in the coordinates of the part. The z axis is the part's axis.
        """
        weight = self._second_weight(xyz)[:, None]
        colours = np.asarray(self.first) * (1 - weight) + np.asarray(self.second) * weight
        if self.badge:
            distance = np.hypot(xyz[:, 1], xyz[:, 2] - self.badge_height)
            for radius, colour in ((self.badge, self.badge_colour), (0.55 * self.badge, self.second)):
                inside = np.clip((radius - distance) / 0.004 + 0.5, 0, 1)[:, None]
                colours += (np.asarray(colour) - colours) * inside
        return colours * self._brightness(xyz)[:, None]

    def _second_weight(self, xyz: Array) -> Array:
        """Return the weight (N,) in [0, 1] of the second colour at positions ``xyz`` (N, 3)."""
        frequency = 2 * np.pi / self.period
        x, y, z = xyz.T
        if self.kind == "plain":
            return np.zeros(len(xyz))
        if self.kind == "noise":
            waves = np.sin(frequency * (0.8 * x + 0.3 * y + 0.5 * z) + self.phase)
            waves += np.sin(frequency * (-0.4 * x + 0.7 * y + 0.6 * z) + 2.1 * self.phase)
            waves += np.sin(frequency * (0.3 * x - 0.6 * y + 0.9 * z) + 3.7 * self.phase)
            return np.clip(0.5 + 0.55 * waves, 0, 1)
        if self.kind == "stripes":
            return _sharpen(np.sin(frequency * (0.25 * x + 0.5 * y + 0.83 * z) + self.phase))
        along = np.sin(frequency * z + self.phase)
        if self.kind == "hoops":
            return _sharpen(along)
        waves = along * np.sin(self.around * np.arctan2(y, x) + self.phase)
        return _sharpen(waves) if self.kind == "checks" else _sharpen(np.abs(waves) - 0.45)

    def _brightness(self, xyz: Array) -> Array:
        """Return the brightness factor (N,) that varies smoothly over the surface, so that large areas of one colour
        still have texture."""
        return 0.95 + 0.05 * np.sin(xyz @ np.array([23.0, 31.0, 27.0]) + self.phase)


def _sharpen(waves: Array) -> Array:
    """Convert a sine wave in [-1, 1] to a square wave in [0, 1] with soft edges, whose width is about a tenth of the
    period."""
    return np.clip(0.5 + 2.5 * waves, 0, 1)


def hsv(hue: float, saturation: float, value: float) -> Colour:
    """Convert HSV to RGB in [0, 1]. The hue is periodic with period 1."""
    return colorsys.hsv_to_rgb(hue % 1.0, saturation, value)


@dataclass(frozen=True)
class Wardrobe:
    """Patterns of the figure's parts."""

    shirt: Pattern
    sleeve: Pattern
    shorts: Pattern
    sock: Pattern
    shoe: Pattern
    skin: Pattern
    face: Pattern
    hair: Pattern
    band: Pattern
    white: Pattern
    dark: Pattern
    mouth: Pattern


def choose_wardrobe(rng: np.random.Generator) -> Wardrobe:
    """Choose random patterns for the clothes, the skin and the hair. The clothes have three matching hues."""
    hue = float(rng.uniform())
    warm, cool, third = hsv(hue, 0.72, 0.9), hsv(hue + 0.45, 0.75, 0.55), hsv(hue + 0.17, 0.7, 0.95)
    pale = hsv(hue + 0.08, 0.12, 0.97)
    tan = hsv(0.065 + rng.uniform(-0.015, 0.015), rng.uniform(0.35, 0.55), rng.uniform(0.65, 0.92))
    rosy = (min(tan[0] * 1.05, 1.0), tan[1] * 0.86, tan[2] * 0.8)
    locks = hsv(rng.uniform(0.0, 0.11), rng.uniform(0.5, 0.85), rng.uniform(0.25, 0.6))
    shirt: Kind = rng.choice(["stripes", "hoops", "checks"])
    shorts: Kind = rng.choice(["checks", "dots", "noise"])

    def phase() -> float:
        return float(rng.uniform(0, 2 * np.pi))

    return Wardrobe(
        shirt=Pattern(shirt, warm, pale, 0.13, 7, phase(), 0.085, 0.17, cool),
        sleeve=Pattern("hoops", warm, pale, 0.09, 4, phase()),
        shorts=Pattern(shorts, cool, third, 0.12, 6, phase()),
        sock=Pattern("hoops", pale, cool, 0.085, 4, phase()),
        shoe=Pattern("stripes", third, warm, 0.09, 4, phase()),
        skin=Pattern("noise", tan, rosy, 0.14, 4, phase()),
        face=Pattern("noise", tan, rosy, 0.17, 4, phase()),
        hair=Pattern("stripes", locks, (locks[0] * 0.6, locks[1] * 0.6, locks[2] * 0.6), 0.07, 5, phase()),
        band=Pattern("checks", third, pale, 0.12, 5, phase()),
        white=Pattern("plain", (0.97, 0.97, 0.97), (0.0, 0.0, 0.0)),
        dark=Pattern("plain", (0.07, 0.07, 0.1), (0.0, 0.0, 0.0)),
        mouth=Pattern("plain", (0.62, 0.14, 0.16), (0.0, 0.0, 0.0)),
    )
