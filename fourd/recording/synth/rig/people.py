"""People who walk behind the subject, outside the ring of cameras. They make mattes difficult: they move as the subject
does, but are not part of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, estimate_up
from fourd.recording.capture.focus import median_distance, viewing_centre
from fourd.recording.synth.dome.people import place_on_floor, walking_posture
from fourd.recording.synth.figure import Figure, Part, make_figure, rotation_z
from fourd.recording.synth.render import composite_parts
from fourd.recording.synth.rig.sources import Layer

Array = NDArray[np.float64]

CAMERA_DISTANCE_M = 3.6
FOCUS_HEIGHT_M = 0.88
"""The median distance of the cameras from the point they look at, and the height of this point above the floor: those
of the ring of fourd synth. They give captures of unknown scale a size and a floor."""
PATH_RADIUS_M = 4.9
SPEED_M_S = 1.3
STRIDE_M = 1.35
"""Distance that a person walks in one gait cycle."""
NEAREST_M = 1.2
"""Depth from which on people are rendered. At a smaller depth, a person on the circle is at least 70 degrees away from
the optical axis of a camera of the ring."""
ARC_SHARE = 0.3
"""Cameras whose mean is farther from the middle than this fraction of their distance are on one side of the scene. The
people then walk on the other side, where the cameras see them."""
SIDE_SPREAD = 0.35
"""Angle in radians between neighbouring people on the other side of the scene."""


@dataclass(frozen=True, eq=False)
class Walker:
    """A person who walks on a circle around the subject.

    Attributes:
        figure: body and clothes.
        angle: angle on the circle at the time 0, in radians.
        direction: 1 or -1, the direction of the walk.
    """

    figure: Figure
    angle: float
    direction: float


@dataclass(frozen=True, eq=False)
class Stage:
    """Coordinates in metres around the subject: z points up from the floor, and the cameras look at the z axis.

    Attributes:
        R_stage_world: (3, 3) rotation.
        origin: (3,) origin of the stage in world coordinates.
        metre: length of a metre in world units.
    """

    R_stage_world: Array
    origin: Array
    metre: float

    def camera(self, camera: Camera) -> Camera:
        """Return a camera in the coordinates of the stage, which sees the stage as the camera sees the world."""
        rotation = camera.rotation @ self.R_stage_world.T
        centre = self.R_stage_world @ (camera.centre - self.origin) / self.metre
        return replace(camera, rotation=rotation, translation=-rotation @ centre)


def make_stage(cameras: Sequence[Camera]) -> Stage:
    """Estimate the floor and the scale of a capture from its cameras alone."""
    up, focus = estimate_up(cameras), viewing_centre(cameras)
    metre = median_distance(cameras, focus) / CAMERA_DISTANCE_M
    aside = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    aside /= np.linalg.norm(aside)
    return Stage(np.stack([aside, np.cross(up, aside), up]), focus - FOCUS_HEIGHT_M * metre * up, metre)


def draw_walkers(count: int, cameras: Sequence[Camera], stage: Stage, rng: np.random.Generator) -> list[Walker]:
    """Draw people and their starts, evenly spread around the subject or on the side that the cameras look at."""
    middle = np.mean([stage.camera(camera).centre[:2] for camera in cameras], axis=0)
    start, turn = float(rng.uniform(0, 2 * np.pi)), 2 * np.pi / max(count, 1)
    if np.linalg.norm(middle) > ARC_SHARE * CAMERA_DISTANCE_M:
        start, turn = float(np.arctan2(-middle[1], -middle[0])), SIDE_SPREAD
        start -= turn * (count - 1) / 2
    seeds, directions = rng.integers(0, 2**31, count), rng.choice([-1.0, 1.0], count)
    return [
        Walker(make_figure(int(seed)), start + turn * index, float(direction))
        for index, (seed, direction) in enumerate(zip(seeds, directions, strict=True))
    ]


def pose_walker(walker: Walker, seconds: float) -> list[Part]:
    """Return the parts of a person at a time, in the coordinates of the stage."""
    distance = SPEED_M_S * seconds
    angle = walker.angle + walker.direction * distance / PATH_RADIUS_M
    heading = rotation_z(angle + walker.direction * np.pi / 2)
    posture = walking_posture(heading, 2 * np.pi * (distance / STRIDE_M + walker.figure.start))
    place = PATH_RADIUS_M * np.array([np.cos(angle), np.sin(angle)])
    return place_on_floor(walker.figure, posture, place).parts


def render_walkers(walkers: Sequence[Walker], camera: Camera, seconds: float) -> Layer:
    """Render the people at a time. ``camera`` is in the coordinates of the stage."""
    people = [pose_walker(walker, seconds) for walker in walkers]
    parts = [part for person in people if _is_ahead(person, camera) for part in person]
    black = np.zeros((camera.height, camera.width, 3))
    rgb, coverage, _ = composite_parts(parts, camera, black, 0.0)
    return Layer(rgb, coverage)


def _is_ahead(person: Sequence[Part], camera: Camera) -> bool:
    """Return whether a person is far enough before a camera's plane to be seen. Others, who pass beside the camera,
    would make rendering slow: their parts may extend to both sides of the plane."""
    return float(camera.forward @ (person[0].origin - camera.centre)) > NEAREST_M
