"""The synthetic figure: rounded parts on a skeleton, whose joint angles are smooth, periodic functions of time.

World units are metres, and +z points up. The figure stands at the origin and faces +x. The axis +y points to the
figure's left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.recording.synth.patterns import Pattern, Wardrobe, choose_wardrobe

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Part:
    """A part of the figure: the convex hull of two spheres (a rounded cone), scaled along the axes of the part.

    Attributes:
        frame: (3, 3) rotation R_world_part from the part's axes to the world's axes.
        origin: (3,) centre of the first sphere in world coordinates, in metres.
        stretch: (3,) scale factors along the part's axes.
        length: distance along +z between the centres of the first and the second sphere before scaling, in metres. If
            the length is 0, the part is an ellipsoid.
        radii: radii of the first and of the second sphere before scaling, in metres.
        pattern: colours of the surface.
    """

    frame: Array
    origin: Array
    stretch: Array
    length: float
    radii: tuple[float, float]
    pattern: Pattern

    def spheres(self) -> list[tuple[Array, float]]:
        """Return two spheres whose convex hull contains the part. Each sphere is given by its centre (3,) in world
        coordinates and its radius, both in metres."""
        scale = float(self.stretch.max())
        end = self.origin + self.frame[:, 2] * (self.length * self.stretch[2])
        return [(self.origin, self.radii[0] * scale), (end, self.radii[1] * scale)]


@dataclass(frozen=True)
class Figure:
    """Random properties of a figure.

    Attributes:
        leg: factor that scales the length of the legs.
        arm: factor that scales the length of the arms.
        girth: factor that scales the width of trunk and limbs.
        head: factor that scales the head.
        swing: factor that scales the swing angles of arms and legs.
        start: phase of the gait in frame 0, as a number of gait cycles.
        wardrobe: patterns of the parts.
    """

    leg: float
    arm: float
    girth: float
    head: float
    swing: float
    start: float
    wardrobe: Wardrobe


@dataclass(frozen=True)
class LegAngles:
    """Angles of a leg in radians.

    Attributes:
        swing: rotation of the thigh to the front, relative to the pelvis.
        bend: bend of the knee.
        foot: rotation of the toes downwards, relative to the shin.
    """

    swing: float
    bend: float
    foot: float


@dataclass(frozen=True)
class ArmAngles:
    """Angles of an arm in radians.

    Attributes:
        swing: rotation of the upper arm to the front, relative to the chest.
        bend: bend of the elbow.
        spread: rotation of the upper arm away from the trunk.
        inward: rotation of the forearm towards the other arm.
    """

    swing: float
    bend: float
    spread: float = 0.3
    inward: float = 0.2


@dataclass(frozen=True, eq=False)
class Posture:
    """A posture of the figure, without its position.

    Attributes:
        pelvis: (3, 3) rotation R_world_pelvis.
        chest: (3, 3) rotation R_world_chest.
        head: (3, 3) rotation R_world_head.
        legs: angles of the left and of the right leg.
        arms: angles of the left and of the right arm.
        hair_phase: phase of the swinging ponytail in radians.
    """

    pelvis: Array
    chest: Array
    head: Array
    legs: tuple[LegAngles, LegAngles]
    arms: tuple[ArmAngles, ArmAngles]
    hair_phase: float


@dataclass(frozen=True)
class PosedFigure:
    """The parts of a posed figure.

    Attributes:
        parts: all parts.
        foot_indices: indices of the feet among the parts, left and right.
        hand_indices: indices of the hands among the parts, left and right.
    """

    parts: list[Part]
    foot_indices: list[int]
    hand_indices: list[int]

    @property
    def feet(self) -> list[Part]:
        """The left and the right foot."""
        return [self.parts[index] for index in self.foot_indices]

    @property
    def hands(self) -> list[Part]:
        """The left and the right hand."""
        return [self.parts[index] for index in self.hand_indices]

    def moved(self, shift: Array) -> PosedFigure:
        """Return the figure moved by the vector (3,) in metres."""
        return replace(self, parts=[replace(part, origin=part.origin + shift) for part in self.parts])


def make_figure(seed: int) -> Figure:
    """Create a figure with random properties. The same seed gives the same figure."""
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


def pose_figure(figure: Figure, phase: float) -> list[Part]:
    """Compute the parts of the figure at the time ``phase``, in gait cycles.

    One gait cycle consists of two steps, and each step includes a leap.
    """
    p = 2 * np.pi * (phase + figure.start)
    posed = assemble_figure(figure, _running_posture(figure, p))
    leap = 0.11 * np.sin(p) ** 2 * (1 + 0.45 * np.sin(p))
    return posed.moved(np.array([0.07 * np.cos(p), 0.09 * np.sin(p), leap - _lowest_height(posed.feet)])).parts


def assemble_figure(figure: Figure, posture: Posture) -> PosedFigure:
    """Return the figure in the given posture. The waist is at the origin."""
    waist = np.zeros(3)
    parts = _make_trunk(figure, posture.pelvis, posture.chest, waist)
    feet: list[int] = []
    hands: list[int] = []
    for side, leg_angles, arm_angles in zip((1.0, -1.0), posture.legs, posture.arms, strict=True):
        parts += _make_leg(figure, posture.pelvis, waist, side, leg_angles)
        feet.append(len(parts) - 1)
        parts += _make_arm(figure, posture.chest, waist, side, arm_angles)
        hands.append(len(parts) - 1)
    parts += _make_head(figure, posture.head, posture.chest, waist, posture.hair_phase)
    return PosedFigure(parts, feet, hands)


def _running_posture(figure: Figure, p: float) -> Posture:
    """Return the posture at the phase ``p`` of the gait, in radians."""
    hips = rotation_z(0.45 * np.sin(p) + 0.2 * np.sin(2 * p))
    return Posture(
        pelvis=hips @ rotation_z(0.22 * np.sin(p)) @ rotation_x(0.06 * np.cos(p)),
        chest=hips @ rotation_y(0.2 + 0.06 * np.cos(2 * p)) @ rotation_z(-0.38 * np.sin(p)),
        head=hips @ rotation_y(0.06 - 0.08 * np.cos(2 * p)),
        legs=(_running_leg(figure, p), _running_leg(figure, p + np.pi)),
        arms=(_running_arm(figure, p), _running_arm(figure, p + np.pi)),
        hair_phase=p,
    )


def _running_leg(figure: Figure, p: float) -> LegAngles:
    return LegAngles(
        swing=figure.swing * (0.18 + 0.78 * np.sin(p)),
        bend=0.2 + 1.45 * (0.5 + 0.5 * np.cos(p + 0.35)) ** 1.5,
        foot=-0.1 - 0.35 * np.sin(p) + 0.35 * (0.5 + 0.5 * np.cos(p)),
    )


def _running_arm(figure: Figure, p: float) -> ArmAngles:
    return ArmAngles(swing=-figure.swing * (0.95 * np.sin(p)) - 0.1, bend=1.25 + 0.4 * np.sin(p + np.pi))


def _make_trunk(figure: Figure, pelvis: Array, chest: Array, waist: Array) -> list[Part]:
    wear, girth = figure.wardrobe, figure.girth
    return [
        _cone(pelvis, waist + pelvis @ [0, 0, -0.05], 0.09, 0.15 * girth, 0.135 * girth, wear.shorts, (0.74, 1, 1)),
        _cone(chest, waist + chest @ [0, 0, 0.06], 0.3, 0.135 * girth, 0.175 * girth, wear.shirt, (0.7, 1, 1)),
        _cone(chest, waist + chest @ [0, 0, 0.42], 0.14, 0.06 * girth, 0.052 * girth, wear.skin),
    ]


def _make_leg(figure: Figure, pelvis: Array, waist: Array, side: float, angles: LegAngles) -> list[Part]:
    """Create the parts of a leg. The last part is the foot."""
    wear, girth = figure.wardrobe, figure.girth
    thigh, shin = 0.42 * figure.leg, 0.4 * figure.leg
    upper = pelvis @ rotation_x(side * 0.06) @ rotation_y(-angles.swing)
    lower = upper @ rotation_y(angles.bend)
    foot = lower @ rotation_y(angles.foot)
    hip = waist + pelvis @ [0, side * 0.095 * girth, -0.09]
    knee = hip - upper[:, 2] * thigh
    ankle = knee - lower[:, 2] * shin
    heel = ankle + foot @ [-0.025, 0, -0.045]
    return [
        _limb(upper, hip, 0.55 * thigh, 0.1 * girth, 0.092 * girth, wear.shorts),
        _limb(upper, hip - upper[:, 2] * 0.5 * thigh, 0.5 * thigh, 0.077 * girth, 0.06 * girth, wear.skin),
        _limb(lower, knee, 0.4 * shin, 0.059 * girth, 0.058 * girth, wear.skin),
        _limb(lower, knee - lower[:, 2] * 0.32 * shin, 0.68 * shin, 0.062 * girth, 0.043 * girth, wear.sock),
        _cone(foot @ rotation_y(np.pi / 2), heel, 0.17, 0.056, 0.047, wear.shoe, (0.85, 1, 1)),
    ]


def _make_arm(figure: Figure, chest: Array, waist: Array, side: float, angles: ArmAngles) -> list[Part]:
    """Create the parts of an arm. The last part is the hand."""
    wear, girth = figure.wardrobe, figure.girth
    upper = chest @ rotation_x(side * angles.spread) @ rotation_y(-angles.swing)
    lower = upper @ rotation_y(-angles.bend) @ rotation_x(-side * angles.inward)
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


def _make_head(figure: Figure, rotation: Array, chest: Array, waist: Array, p: float) -> list[Part]:
    wear, size = figure.wardrobe, figure.head
    centre = waist + chest @ [0, 0, 0.53] + rotation @ [0.015, 0, 0.1 * size]

    def ball(position: Sequence[float], stretch: Sequence[float], pattern: Pattern) -> Part:
        return _cone(
            rotation,
            centre + rotation @ (size * np.asarray(position)),
            0.0,
            1.0,
            1.0,
            pattern,
            size * np.array(stretch),
        )

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
    return parts + _make_ponytail(rotation, centre + rotation @ [-0.115 * size, 0, 0.06 * size], p, wear.hair)


def _make_ponytail(rotation: Array, root: Array, p: float, pattern: Pattern) -> list[Part]:
    """Create the three links of the figure's ponytail. The swing of each link is delayed relative to the previous
    link."""
    parts = []
    frame = rotation @ rotation_y(1.1)
    for link, (thin, thick) in enumerate(((0.03, 0.047), (0.047, 0.043), (0.043, 0.018))):
        lag = p - 0.7 * (link + 1)
        frame = frame @ rotation_y(-0.25 + 0.3 * np.cos(2 * lag)) @ rotation_x(0.3 * np.sin(lag))
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
    """Create a part that extends from ``joint`` in the direction -z of ``frame``."""
    return _cone(frame @ np.diag([1.0, -1.0, -1.0]), joint, length, first, second, pattern)


def _lowest_height(parts: Sequence[Part]) -> float:
    """Approximate the height, in metres, of the lowest point of ``parts`` by a soft minimum over the spheres of the
    parts.

    The soft minimum makes the height change smoothly over time, even when the lowest point moves from one foot to the
    other.
    """
    heights = np.array([centre[2] - radius for part in parts for centre, radius in part.spheres()])
    softness = 0.02
    return float(heights.min() - softness * np.log(np.exp((heights.min() - heights) / softness).sum()))


def rotation_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def rotation_y(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def rotation_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
