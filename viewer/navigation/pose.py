"""Where a viewer stands, and how dragging and keys move it, as in Blender and three.js OrbitControls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera, look_at

Array = NDArray[np.float64]

NARROWEST, WIDEST = np.radians(2.0), np.radians(150.0)
"""Of the vertical field of view."""

_POLE = np.radians(1.0)  # how near to straight up or down an orbit may come
_NEAREST = 1e-3  # of a dolly, world units
_FARTHEST = 1e6


@dataclass(frozen=True, eq=False)
class Pose:
    """A viewer that looks at a pivot. All lengths in world units.

    Attributes:
        pivot: (3,) point that orbits go round, on the viewing axis.
        rotation: (3, 3) R_camera_world; x right, y down, z forward.
        distance: from the eye to the pivot, above 0.
        field_of_view: vertical, in radians.
        up: (3,) unit vector, the world's up.
        offset: (x, y) of the principal point from the picture's centre, in picture heights.
    """

    pivot: Array
    rotation: Array
    distance: float
    field_of_view: float
    up: Array
    offset: tuple[float, float] = (0.0, 0.0)

    @property
    def eye(self) -> Array:
        """(3,) position of the viewer."""
        return self.pivot - self.distance * self.rotation[2]

    def camera(self, width: int, height: int) -> Camera:
        """What the viewer sees in a picture of ``width`` x ``height`` pixels."""
        focal = height / 2 / np.tan(self.field_of_view / 2)
        intrinsics = np.array(
            [
                [focal, 0, width / 2 + self.offset[0] * height],
                [0, focal, height / 2 + self.offset[1] * height],
                [0, 0, 1],
            ]
        )
        return Camera(intrinsics, self.rotation, -self.rotation @ self.eye, width, height)

    def orbited(self, right: float, down: float) -> Pose:
        """Turned about the pivot as if the scene were dragged by these angles in radians; never over a pole."""
        forward = self.rotation[2]
        level = np.cross(forward, self.up)
        length = float(np.linalg.norm(level))
        # Not the picture's own x axis: that of a camera with roll leads past the pole, and over.
        level = level / length if length > 1e-6 else self.rotation[0]
        if level @ self.rotation[0] < 0:  # upside down: the mouse moves what it sees
            right, down = -right, -down
        now = float(np.arccos(np.clip(forward @ self.up, -1, 1)))
        wanted = float(np.clip(now + down, min(now, _POLE), max(now, np.pi - _POLE)))
        turn = _turn(-right * self.up) @ _turn(-(wanted - now) * level)
        return replace(self, rotation=_orthonormal(self.rotation @ turn.T))

    def panned(self, right: float, down: float) -> Pose:
        """Moved sideways as if the scene at the pivot were dragged by these parts of the picture's height."""
        length = 2 * np.tan(self.field_of_view / 2) * self.distance
        return replace(self, pivot=self.pivot - length * (right * self.rotation[0] + down * self.rotation[1]))

    def dollied(self, factor: float) -> Pose:
        """With the distance to the pivot multiplied by ``factor``, above 0."""
        return replace(self, distance=float(np.clip(self.distance * factor, _NEAREST, _FARTHEST)))

    def flown(self, right: float, up: float, forward: float) -> Pose:
        """Moved by world units along its own axes; the pivot comes along."""
        step = right * self.rotation[0] - up * self.rotation[1] + forward * self.rotation[2]
        return replace(self, pivot=self.pivot + step)

    def widened(self, field_of_view: float) -> Pose:
        """With another vertical field of view, in radians, brought into its range."""
        return replace(self, field_of_view=float(np.clip(field_of_view, NARROWEST, WIDEST)))


def pose_of(camera: Camera, focus: Sequence[float] | Array, up: Array, size: tuple[int, int]) -> Pose:
    """The pose that sees what ``camera`` does, in a picture of ``size`` (width, height): nothing of it is cut off.

    The pivot is the point of the viewing axis nearest to ``focus``, where that lies ahead.
    """
    width, height = size
    zoom = min(width / camera.width, height / camera.height)
    # Pixels of a pose are square: where those of the camera are not, the longer focal length would cut something off.
    focal = zoom * float(min(camera.intrinsics[0, 0], camera.intrinsics[1, 1]))
    distance = float((np.asarray(focus, np.float64) - camera.centre) @ camera.forward)
    if not distance > _NEAREST:
        distance = max(1.0, _NEAREST)
    return Pose(
        pivot=camera.centre + distance * camera.forward,
        rotation=camera.rotation,
        distance=distance,
        field_of_view=float(2 * np.arctan2(height / 2, focal)),
        up=up,
        offset=(
            zoom * float(camera.intrinsics[0, 2] - camera.width / 2) / height,
            zoom * float(camera.intrinsics[1, 2] - camera.height / 2) / height,
        ),
    )


def facing(eye: Array, pivot: Array, up: Array, field_of_view: float) -> Pose:
    """At ``eye``, looking at ``pivot`` with ``up`` towards the top."""
    seen = look_at(eye, pivot, up, np.eye(3), 1, 1)
    return Pose(pivot, seen.rotation, float(np.linalg.norm(pivot - eye)), field_of_view, up)


def between(start: Pose, end: Pose, share: float) -> Pose:
    """On the way from one pose to another; ``share`` in [0, 1], slow at both ends."""
    t = share * share * (3 - 2 * share)
    if share >= 1:
        return end
    whole = np.asarray(cv2.Rodrigues(end.rotation @ start.rotation.T)[0], np.float64).ravel()
    return Pose(
        pivot=start.pivot + t * (end.pivot - start.pivot),
        rotation=_orthonormal(_turn(t * whole) @ start.rotation),
        distance=float(np.exp((1 - t) * np.log(start.distance) + t * np.log(end.distance))),
        field_of_view=(1 - t) * start.field_of_view + t * end.field_of_view,
        up=end.up,
        offset=(
            (1 - t) * start.offset[0] + t * end.offset[0],
            (1 - t) * start.offset[1] + t * end.offset[1],
        ),
    )


def _turn(vector: Array) -> Array:
    """The rotation about ``vector`` (3,) by its length in radians."""
    return np.asarray(cv2.Rodrigues(np.ascontiguousarray(vector, np.float64))[0], np.float64)


def _orthonormal(rotation: Array) -> Array:
    """The nearest rotation: thousands of small turns add up their rounding."""
    left, _, right = np.linalg.svd(rotation)
    return left @ right
