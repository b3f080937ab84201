"""The cameras of the dome: their places in the wall, their dark bodies, and their colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at
from fourd.recording.synth.dome.room import CENTRE, RADIUS, Room, spiral_directions
from fourd.recording.synth.figure import Part
from fourd.recording.synth.patterns import Pattern

Array = NDArray[np.float64]

LOWEST, HIGHEST = 0.7, 3.2
"""Range of the cameras' heights above the floor in metres."""
INSET = 0.03
"""Distance of a camera's centre from the wall in metres."""
BODY_RADIUS = 0.045
BODY_FRONT = 0.05
"""Length of a camera's body in front of the camera's centre in metres."""
BODY_BACK = 0.09
TARGET = np.array([0.0, 0.0, 1.42])
EXPOSURE_SPREAD, CHANNEL_SPREAD = 0.08, 0.035
"""Standard deviations of the logarithms of a camera's exposure, and of its gain per channel."""
NEIGHBOURS = 4

_DARK = Pattern("plain", (0.06, 0.06, 0.07), (0.0, 0.0, 0.0))
_LENS = Pattern("plain", (0.2, 0.19, 0.24), (0.0, 0.0, 0.0))


@dataclass(frozen=True, eq=False)
class DomeCamera:
    """A camera in the wall.

    Attributes:
        name: name of the camera.
        camera: calibration.
        gain: (3,) factors by which the camera multiplies RGB colours. The geometric mean over all cameras is 1 in each
            channel.
        body: dark body around the camera's centre, which other cameras see.
        box: dark box on the wall beside the camera, or no part.
    """

    name: str
    camera: Camera
    gain: Array
    body: tuple[Part, ...]
    box: tuple[Part, ...]


def make_rig(room: Room, count: int, width: int, height: int, rng: np.random.Generator) -> list[DomeCamera]:
    """Create cameras that are spread over the wall and look towards the middle of the room, with random differences in
    position, direction, focal length and colours."""
    band = (np.array([LOWEST, HIGHEST]) - CENTRE[2]) / RADIUS
    directions = spiral_directions(count, float(band[0]), float(band[1]))
    gains = np.exp(rng.normal(0, EXPOSURE_SPREAD, (count, 1)) + rng.normal(0, CHANNEL_SPREAD, (count, 3)))
    gains /= np.exp(np.log(gains).mean(axis=0))
    rig = []
    for index, direction in enumerate(directions):
        direction = direction + rng.normal(0, 0.02, 3)
        direction /= np.linalg.norm(direction)
        position = CENTRE + direction * (room.wall_distance(direction) - INSET)
        focal = width * (0.73 if rng.uniform() < 0.6 else float(rng.uniform(0.74, 0.86)))
        middle = np.array([width, height]) / 2 + rng.uniform(-0.008, 0.008, 2) * width
        intrinsics = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1.0]])
        target = TARGET + rng.normal(0, (0.12, 0.12, 0.08))
        camera = look_at(position, target, np.array([0.0, 0.0, 1.0]), intrinsics, width, height)
        box = _make_box(room, direction) if index % 3 == 0 else ()
        rig.append(DomeCamera(f"{index:02d}", camera, gains[index], _make_body(camera), box))
    return rig


def visible_fixtures(rig: Sequence[DomeCamera], index: int) -> list[Part]:
    """Return the bodies and boxes that the camera ``index`` can see: all except its own body, which surrounds it."""
    bodies = [part for other, item in enumerate(rig) if other != index for part in item.body]
    return bodies + [part for item in rig for part in item.box]


def suggest_test_views(rig: Sequence[DomeCamera]) -> list[str]:
    """Return the names of about one in eight cameras that have neighbours on all sides, and are not neighbours of each
    other."""
    centres = np.array([item.camera.centre for item in rig])
    distances = np.linalg.norm(centres[:, None] - centres, axis=-1)
    neighbours = np.argsort(distances, axis=1, kind="stable")[:, 1 : NEIGHBOURS + 1]
    offsets = np.linalg.norm(centres[neighbours].mean(axis=1) - centres, axis=1)
    chosen: list[int] = []
    for index in np.argsort(offsets, kind="stable"):
        if len(chosen) < max(1, len(rig) // 8) and not set(neighbours[index]) & set(chosen):
            chosen.append(int(index))
    return [rig[index].name for index in sorted(chosen)]


def _make_body(camera: Camera) -> tuple[Part, ...]:
    """Create a rounded cylinder around the camera's centre, with a lens at its front."""
    length, radii = BODY_BACK + BODY_FRONT - BODY_RADIUS, (BODY_RADIUS, 0.8 * BODY_RADIUS)
    housing = Part(camera.rotation.T, camera.centre - BODY_BACK * camera.forward, np.ones(3), length, radii, _DARK)
    front = camera.centre + (BODY_FRONT - 0.012) * camera.forward
    return housing, Part(camera.rotation.T, front, np.array([0.026, 0.026, 0.008]), 0.0, (1.0, 1.0), _LENS)


def _make_box(room: Room, direction: Array) -> tuple[Part, ...]:
    """Create a flat dark box on the wall below the place in the given direction."""
    below = direction - np.array([0.0, 0.0, 0.1])
    below /= np.linalg.norm(below)
    across = np.cross(below, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    frame = np.stack([below, np.cross(across, below), across], axis=1)
    length = 0.24
    start = CENTRE + below * (room.wall_distance(below) - 0.02) - across * length / 2
    return (Part(frame, start, np.array([1.0, 1.0, 1.0]), length, (0.035, 0.035), _DARK),)
