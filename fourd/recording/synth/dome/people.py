"""The dynamic parts of the dome: a person who stands still, a person who walks past cameras, and the ball that they
throw to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.recording.synth.figure import (
    ArmAngles,
    Figure,
    LegAngles,
    Part,
    PosedFigure,
    Posture,
    assemble_figure,
    make_figure,
    rotation_x,
    rotation_y,
    rotation_z,
)
from fourd.recording.synth.patterns import Pattern

Array = NDArray[np.float64]

LAP_FRAMES = 90
"""Approximate number of frames in which the walking person completes one lap."""
LAP_STEPS = 3
"""Number of gait cycles per lap: about 1.35 m per cycle."""
LAP_CENTRE = np.array([1.2, 0.1])
LAP_RADII = np.array([0.5, 0.78])
LAP_START = np.radians(-35.0)
STANDING = np.array([-1.0, -0.2])
BALL_RADIUS = 0.12
BALL = Pattern("hoops", (0.72, 0.16, 0.1), (0.52, 0.09, 0.07), 0.08)
THROW = np.radians((70.0, 160.0))
RETURN = np.radians((-40.0, 50.0))
"""Angles of the lap at which the ball leaves one person and reaches the other."""
LOB = 0.55
"""Height of the ball's path above the straight line in metres."""


@dataclass(frozen=True)
class Cast:
    """The two people."""

    standing: Figure
    walking: Figure


@dataclass(frozen=True, eq=False)
class Moment:
    """The dynamic parts of the dome at one time.

    Attributes:
        standing: parts of the person who stands.
        walking: parts of the person who walks.
        ball: the ball.
        feet: the four feet, which are among the parts of the people.
    """

    standing: list[Part]
    walking: list[Part]
    ball: Part
    feet: list[Part]

    @property
    def parts(self) -> list[Part]:
        """All parts."""
        return [*self.standing, *self.walking, self.ball]


def make_cast(seed: int) -> Cast:
    """Create two people with random properties. The same seed gives the same people."""
    rng = np.random.default_rng([seed, 11])
    first, second = (make_figure(int(number)) for number in rng.integers(0, 2**31, 2))
    return Cast(_dress(first, 0.62, rng), _dress(second, 0.47, rng))


def _dress(figure: Figure, grey: float, rng: np.random.Generator) -> Figure:
    """Replace the bright clothes of a figure: a shirt of nearly the wall's colour, and dark trousers."""

    def cloth(brightness: float, contrast: float, period: float) -> Pattern:
        first = brightness * (1 + rng.normal(0, 0.04, 3))
        second = first * (1 - contrast)
        phase = float(rng.uniform(0, 2 * np.pi))
        return Pattern("noise", (first[0], first[1], first[2]), (second[0], second[1], second[2]), period, 4, phase)

    shirt, trousers = cloth(grey, 0.25, 0.11), cloth(0.13, 0.4, 0.09)
    wardrobe = replace(
        figure.wardrobe,
        shirt=shirt,
        sleeve=shirt,
        shorts=trousers,
        sock=trousers,
        shoe=cloth(0.3, 0.6, 0.07),
        band=figure.wardrobe.hair,
    )
    return replace(figure, wardrobe=wardrobe)


def lap_angle(frame: int, frames: int) -> float:
    """Return the angle of the walking person on the lap in radians. The capture covers a whole number of laps, so it
    can be played in a loop."""
    return float(LAP_START + 2 * np.pi * frame * max(1, round(frames / LAP_FRAMES)) / frames)


def pose_cast(cast: Cast, angle: float) -> Moment:
    """Compute all dynamic parts at a time that is given by the angle of the lap in radians."""
    standing, walking = _stand(cast.standing, angle), _walk(cast.walking, angle)
    position = _ball_position(angle, _place_of_ball(standing), _place_of_ball(walking))
    ball = Part(rotation_y(2 * angle), position, np.ones(3), 0.0, (BALL_RADIUS, BALL_RADIUS), BALL)
    return Moment(standing.parts, walking.parts, ball, standing.feet + walking.feet)


def lowest_height(parts: Sequence[Part]) -> float:
    """Return the exact height of the parts' lowest point in metres."""
    lowest = np.inf
    for part in parts:
        reach = float(np.linalg.norm(part.stretch * part.frame[2]))
        rise = float(part.frame[2, 2] * part.stretch[2] * part.length)
        lowest = min(lowest, part.origin[2] - reach * part.radii[0], part.origin[2] + rise - reach * part.radii[1])
    return float(lowest)


def _stand(figure: Figure, angle: float) -> PosedFigure:
    """Pose the standing person, whose trunk sways by some millimetres."""
    heading = rotation_z(0.12)
    legs = tuple(LegAngles(swing, 0.06, swing - 0.06) for swing in (0.1, -0.02))
    arms = (ArmAngles(0.42, 1.25, 0.16, 0.4), ArmAngles(0.38, 1.3, 0.16, 0.4))
    sway = 0.012 * np.sin(angle)
    chest = heading @ rotation_y(0.05 + sway) @ rotation_x(0.5 * sway)
    head = heading @ rotation_z(0.08 * np.sin(angle)) @ rotation_y(0.05)
    posture = Posture(heading, chest, head, (legs[0], legs[1]), arms, 0.0)
    return place_on_floor(figure, posture, STANDING)


def _walk(figure: Figure, angle: float) -> PosedFigure:
    """Pose the walking person, who looks ahead along an ellipse."""
    velocity = LAP_RADII * (-np.sin(angle), np.cos(angle))
    heading = rotation_z(float(np.arctan2(velocity[1], velocity[0])))
    p = LAP_STEPS * (angle - LAP_START) + 2 * np.pi * figure.start
    return place_on_floor(figure, walking_posture(heading, p), LAP_CENTRE + LAP_RADII * (np.cos(angle), np.sin(angle)))


def walking_posture(heading: Array, p: float) -> Posture:
    """Return the posture of a person who walks.

    Args:
        heading: (3, 3) rotation about the z axis, which turns the x axis into the direction of the walk.
        p: phase of the gait in radians.
    """
    swing = float(np.sin(p))
    return Posture(
        pelvis=heading @ rotation_z(0.1 * swing),
        chest=heading @ rotation_y(0.06) @ rotation_z(-0.12 * swing),
        head=heading @ rotation_z(0.3) @ rotation_y(0.05),
        legs=(_walking_leg(p), _walking_leg(p + np.pi)),
        arms=(ArmAngles(0.4 - 0.1 * swing, 1.2, 0.16, 0.4), ArmAngles(0.4 + 0.1 * swing, 1.2, 0.16, 0.4)),
        hair_phase=p,
    )


def _walking_leg(p: float) -> LegAngles:
    swing = 0.4 * np.sin(p)
    bend = 0.08 + 0.8 * max(0.0, float(np.cos(p + 0.4))) ** 2
    return LegAngles(float(swing), bend, float(swing - bend) * 0.8)


def place_on_floor(figure: Figure, posture: Posture, position: Array) -> PosedFigure:
    """Put the figure on the floor at the position (2,)."""
    posed = assemble_figure(figure, posture)
    return posed.moved(np.array([*position, -lowest_height(posed.feet)]))


def _place_of_ball(person: PosedFigure) -> Array:
    """Return the position (3,) at which a person holds the ball: slightly in front of both hands."""
    left, right = (hand.origin for hand in person.hands)
    forward = np.cross(left - right, [0.0, 0.0, 1.0])
    return np.asarray((left + right) / 2 + 0.05 * forward / np.linalg.norm(forward))


def _ball_position(angle: float, standing: Array, walking: Array) -> Array:
    turn = (angle + np.pi) % (2 * np.pi) - np.pi
    for (start, end), source, target in ((THROW, walking, standing), (RETURN, standing, walking)):
        if start <= turn < end:
            share = (turn - start) / (end - start)
            return np.asarray(source + share * (target - source) + [0, 0, 4 * LOB * share * (1 - share)])
    return walking if RETURN[1] <= turn < THROW[0] else standing
