"""The figure: rounded parts on a skeleton whose joint angles are smooth, periodic functions of time.

The world is in metres with z up; the figure stands at the origin and looks along +x, its left is +y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.synth.patterns import Pattern, Wardrobe, choose_wardrobe

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Part:
    """A rounded cone (the hull of two spheres), stretched along its own axes.

    Attributes:
        frame: (3, 3) rotation from the part's axes to the world's.
        origin: (3,) centre of the first sphere, in the world.
        stretch: (3,) factors along the part's axes that make the round shape the real one.
        length: distance between the spheres along +z, before the stretch; 0 for an ellipsoid.
        radii: of the first and the second sphere, before the stretch.
        pattern: its colours.
    """

    frame: Array
    origin: Array
    stretch: Array
    length: float
    radii: tuple[float, float]
    pattern: Pattern

    def spheres(self) -> list[tuple[Array, float]]:
        """World spheres whose hull holds the part: centres (3,) and radii in metres."""
        reach = float(self.stretch.max())
        end = self.origin + self.frame[:, 2] * (self.length * self.stretch[2])
        return [(self.origin, self.radii[0] * reach), (end, self.radii[1] * reach)]


@dataclass(frozen=True)
class Figure:
    """What a seed decides: proportions (factors about 1), where the gait begins (turns), clothes."""

    leg: float
    arm: float
    girth: float
    head: float
    swing: float
    start: float
    wardrobe: Wardrobe


def make_figure(seed: int) -> Figure:
    """The figure of a seed; the same for the same seed."""
    rng = np.random.default_rng(seed)
    return Figure(
        leg=float(rng.uniform(0.94, 1.06)),
        arm=float(rng.uniform(0.94, 1.06)),
        girth=float(rng.uniform(0.92, 1.12)),
        head=float(rng.uniform(1.1, 1.25)),
        swing=float(rng.uniform(0.9, 1.1)),
        start=float(rng.uniform(0, 1)),
        wardrobe=choose_wardrobe(rng),
    )


def pose(figure: Figure, phase: float) -> list[Part]:
    """The parts at ``phase`` (turns of the gait; whole numbers look alike): two steps, each with a leap."""
    p = 2 * np.pi * (phase + figure.start)
    hips = _about_z(0.45 * np.sin(p) + 0.2 * np.sin(2 * p))
    pelvis = hips @ _about_z(0.22 * np.sin(p)) @ _about_x(0.06 * np.cos(p))
    chest = hips @ _about_y(0.2 + 0.06 * np.cos(2 * p)) @ _about_z(-0.38 * np.sin(p))
    waist = np.zeros(3)
    parts = _trunk(figure, pelvis, chest, waist)
    feet: list[Part] = []
    for side, offset in ((1.0, 0.0), (-1.0, np.pi)):
        leg, foot = _leg(figure, pelvis, waist, side, p + offset)
        feet += foot
        parts += leg + foot + _arm(figure, chest, waist, side, p + offset)
    parts += _head(figure, hips @ _about_y(0.06 - 0.08 * np.cos(2 * p)), chest, waist, p)
    leap = 0.11 * np.sin(p) ** 2 * (1 + 0.45 * np.sin(p))
    place = np.array([0.07 * np.cos(p), 0.09 * np.sin(p), leap - _lowest(feet)])
    return [_moved(part, place) for part in parts]


def _trunk(figure: Figure, pelvis: Array, chest: Array, waist: Array) -> list[Part]:
    wear, girth = figure.wardrobe, figure.girth
    return [
        _cone(pelvis, waist + pelvis @ [0, 0, -0.05], 0.09, 0.15 * girth, 0.135 * girth, wear.shorts, (0.74, 1, 1)),
        _cone(chest, waist + chest @ [0, 0, 0.06], 0.3, 0.135 * girth, 0.175 * girth, wear.shirt, (0.7, 1, 1)),
        _cone(chest, waist + chest @ [0, 0, 0.42], 0.14, 0.06 * girth, 0.052 * girth, wear.skin),
    ]


def _leg(figure: Figure, pelvis: Array, waist: Array, side: float, p: float) -> tuple[list[Part], list[Part]]:
    wear, girth = figure.wardrobe, figure.girth
    swing = figure.swing * (0.18 + 0.78 * np.sin(p))
    bend = 0.2 + 1.45 * (0.5 + 0.5 * np.cos(p + 0.35)) ** 1.5
    thigh, shin = 0.42 * figure.leg, 0.4 * figure.leg
    upper = pelvis @ _about_x(side * 0.06) @ _about_y(-swing)
    lower = upper @ _about_y(bend)
    foot = lower @ _about_y(-0.1 - 0.35 * np.sin(p) + 0.35 * (0.5 + 0.5 * np.cos(p)))
    hip = waist + pelvis @ [0, side * 0.095 * girth, -0.09]
    knee = hip - upper[:, 2] * thigh
    ankle = knee - lower[:, 2] * shin
    leg = [
        _limb(upper, hip, 0.55 * thigh, 0.1 * girth, 0.092 * girth, wear.shorts),
        _limb(upper, hip - upper[:, 2] * 0.5 * thigh, 0.5 * thigh, 0.077 * girth, 0.06 * girth, wear.skin),
        _limb(lower, knee, 0.4 * shin, 0.059 * girth, 0.058 * girth, wear.skin),
        _limb(lower, knee - lower[:, 2] * 0.32 * shin, 0.68 * shin, 0.062 * girth, 0.043 * girth, wear.sock),
    ]
    heel = ankle + foot @ [-0.025, 0, -0.045]
    return leg, [_cone(foot @ _about_y(np.pi / 2), heel, 0.17, 0.056, 0.047, wear.shoe, (0.85, 1, 1))]


def _arm(figure: Figure, chest: Array, waist: Array, side: float, p: float) -> list[Part]:
    wear, girth = figure.wardrobe, figure.girth
    swing = -figure.swing * (0.95 * np.sin(p)) - 0.1
    bend = 1.25 + 0.4 * np.sin(p + np.pi)
    upper = chest @ _about_x(side * 0.3) @ _about_y(-swing)
    lower = upper @ _about_y(-bend) @ _about_x(-side * 0.2)
    top, fore = 0.27 * figure.arm, 0.24 * figure.arm
    shoulder = waist + chest @ [0, side * 0.19 * girth, 0.39]
    elbow = shoulder - upper[:, 2] * top
    wrist = elbow - lower[:, 2] * fore
    return [
        _limb(upper, shoulder, 0.5 * top, 0.072 * girth, 0.064 * girth, wear.sleeve),
        _limb(upper, shoulder, top, 0.05 * girth, 0.044 * girth, wear.skin),
        _limb(lower, elbow, fore, 0.045 * girth, 0.034 * girth, wear.skin),
        _limb(lower, elbow - lower[:, 2] * 0.66 * fore, 0.05, 0.043 * girth, 0.041 * girth, wear.band),
        _cone(lower, wrist - lower[:, 2] * 0.055, 0.0, 1.0, 1.0, wear.skin, (0.045, 0.036, 0.062)),
    ]


def _head(figure: Figure, turn: Array, chest: Array, waist: Array, p: float) -> list[Part]:
    wear, size = figure.wardrobe, figure.head
    centre = waist + chest @ [0, 0, 0.53] + turn @ [0.015, 0, 0.1 * size]

    def ball(place: Sequence[float], stretch: Sequence[float], pattern: Pattern) -> Part:
        return _cone(turn, centre + turn @ (size * np.asarray(place)), 0.0, 1.0, 1.0, pattern, size * np.array(stretch))

    parts = [
        ball((0, 0, 0), (0.108, 0.098, 0.128), wear.face),
        ball((-0.02, 0, 0.028), (0.11, 0.107, 0.117), wear.hair),
        ball((0.0, 0, 0.058), (0.112, 0.109, 0.026), wear.band),
        ball((0.108, 0, -0.012), (0.022, 0.017, 0.02), wear.skin),
        ball((0.086, 0, -0.065), (0.016, 0.034, 0.011), wear.mouth),
    ]
    for side in (1.0, -1.0):
        parts.append(ball((0.085, side * 0.04, 0.014), (0.021, 0.023, 0.026), wear.white))
        parts.append(ball((0.098, side * 0.038, 0.013), (0.011, 0.012, 0.014), wear.dark))
        parts.append(ball((0.0, side * 0.102, -0.005), (0.024, 0.016, 0.032), wear.skin))
    return parts + _ponytail(turn, centre + turn @ [-0.115 * size, 0, 0.06 * size], p, wear.hair)


def _ponytail(turn: Array, root: Array, p: float, pattern: Pattern) -> list[Part]:
    """Three links, each later than the one before it."""
    parts = []
    frame = turn @ _about_y(1.1)
    for link, (thin, thick) in enumerate(((0.03, 0.047), (0.047, 0.043), (0.043, 0.018))):
        late = p - 0.7 * (link + 1)
        frame = frame @ _about_y(-0.25 + 0.3 * np.cos(2 * late)) @ _about_x(0.3 * np.sin(late))
        parts.append(_limb(frame, root, 0.085, thin, thick, pattern))
        root = root - frame[:, 2] * 0.085
    return parts


def _cone(
    frame: Array,
    origin: Array,
    length: float,
    first: float,
    second: float,
    pattern: Pattern,
    stretch: Sequence[float] | Array = (1.0, 1.0, 1.0),
) -> Part:
    return Part(frame, np.asarray(origin), np.asarray(stretch, dtype=np.float64), length, (first, second), pattern)


def _limb(frame: Array, joint: Array, length: float, first: float, second: float, pattern: Pattern) -> Part:
    """A part that hangs from ``joint`` along the frame's -z."""
    return _cone(frame @ np.diag([1.0, -1.0, -1.0]), joint, length, first, second, pattern)


def _lowest(parts: Sequence[Part]) -> float:
    """Height of the lowest point, smooth when the lower foot changes."""
    heights = np.array([centre[2] - radius for part in parts for centre, radius in part.spheres()])
    softness = 0.02
    return float(heights.min() - softness * np.log(np.exp((heights.min() - heights) / softness).sum()))


def _moved(part: Part, offset: Array) -> Part:
    return Part(part.frame, part.origin + offset, part.stretch, part.length, part.radii, part.pattern)


def _about_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _about_y(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _about_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
