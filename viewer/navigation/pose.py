"""The viewer's pose, which moves by mouse and keys as in Blender and three.js OrbitControls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at

Array = NDArray[np.float64]

MIN_FIELD_OF_VIEW, MAX_FIELD_OF_VIEW = np.radians(2.0), np.radians(150.0)
"""Limits of the vertical field of view, in radians."""

_MIN_POLE_ANGLE = np.radians(1.0)
"""Smallest angle between the view direction and the up axis, in radians."""
_MIN_DISTANCE, _MAX_DISTANCE = 1e-3, 1e6
"""Limits of the distance from the eye to the pivot, in world units."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A viewpoint: an eye, and a pivot on the eye's viewing axis. Lengths are in world units.

    Attributes:
        pivot: point (3,) that the eye orbits around.
        rotation: matrix R_camera_world (3, 3). The camera's x axis points right, its y axis down and its z axis
            forward.
        distance: distance from the eye to the pivot, above 0.
        field_of_view: vertical field of view in radians.
        up: up direction of the world, a unit vector (3,).
        offset: offset (x, y) of the principal point from the image centre, in units of the image height.
    """

    pivot: Array
    rotation: Array
    distance: float
    field_of_view: float
    up: Array
    offset: tuple[float, float] = (0.0, 0.0)

    @property
    def eye(self) -> Array:
        """Position (3,) of the eye in world units."""
        return self.pivot - self.distance * self.rotation[2]

    def camera(self, width: int, height: int, shift: tuple[float, float] = (0.0, 0.0)) -> Camera:
        """Return the camera of this pose for an image of ``width`` x ``height`` pixels.

        ``shift`` moves the picture right and down, in pixels, without distorting it.
        """
        focal = height / 2 / np.tan(self.field_of_view / 2)
        intrinsics = np.array(
            [
                [focal, 0, width / 2 + self.offset[0] * height + shift[0]],
                [0, focal, height / 2 + self.offset[1] * height + shift[1]],
                [0, 0, 1],
            ]
        )
        return Camera(intrinsics, self.rotation, -self.rotation @ self.eye, width, height)

    def orbit(self, right: float, down: float) -> Pose:
        """Rotate the eye about the pivot, as if the user dragged the scene to the right by ``right`` and down by
        ``down``, both in radians.

        The rotation stops 1 degree before the viewing axis is parallel to ``up``.
        """
        forward = self.rotation[2]
        level = np.cross(forward, self.up)
        length = float(np.linalg.norm(level))
        # The camera tilts about a horizontal axis. If a rolled camera tilted about the image's x axis instead, its
        # viewing axis could move past the vertical.
        level = level / length if length > 1e-6 else self.rotation[0]
        if level @ self.rotation[0] < 0:  # if the camera is upside down, keep the drag direction on screen
            right, down = -right, -down
        angle = float(np.arccos(np.clip(forward @ self.up, -1, 1)))
        limits = min(angle, _MIN_POLE_ANGLE), max(angle, np.pi - _MIN_POLE_ANGLE)
        new_angle = float(np.clip(angle + down, *limits))
        turn = _rotation_matrix(-right * self.up) @ _rotation_matrix(-(new_angle - angle) * level)
        return replace(self, rotation=_nearest_rotation(self.rotation @ turn.T))

    def pan(self, right: float, down: float) -> Pose:
        """Translate the eye and the pivot, as if the user dragged the scene at the depth of the pivot.

        ``right`` and ``down`` are the lengths of the drag, as fractions of the image height.
        """
        length = 2 * np.tan(self.field_of_view / 2) * self.distance
        return replace(self, pivot=self.pivot - length * (right * self.rotation[0] + down * self.rotation[1]))

    def dolly(self, factor: float) -> Pose:
        """Multiply the distance to the pivot by ``factor``, which must be positive."""
        return replace(self, distance=float(np.clip(self.distance * factor, _MIN_DISTANCE, _MAX_DISTANCE)))

    def fly(self, right: float, up: float, forward: float) -> Pose:
        """Translate the eye and the pivot along the eye's axes, by lengths in world units."""
        step = right * self.rotation[0] - up * self.rotation[1] + forward * self.rotation[2]
        return replace(self, pivot=self.pivot + step)

    def zoom(self, factor: float, x: float, y: float) -> Pose:
        """Enlarge the image by ``factor`` around a position, without moving the eye.

        ``x`` and ``y`` are the distances of the position from the image centre, in units of the image height. At the
        limits of the field of view, the image is not enlarged further.
        """
        nearer = self.with_field_of_view(2 * np.arctan(np.tan(self.field_of_view / 2) / factor))
        reached = np.tan(self.field_of_view / 2) / np.tan(nearer.field_of_view / 2)
        return replace(nearer, offset=(x + reached * (self.offset[0] - x), y + reached * (self.offset[1] - y)))

    def slide(self, right: float, down: float) -> Pose:
        """Move the image without moving the eye, by lengths in units of the image height."""
        return replace(self, offset=(self.offset[0] + right, self.offset[1] + down))

    def with_field_of_view(self, radians: float) -> Pose:
        """Return the pose with a vertical field of view of ``radians``, clamped to the allowed range."""
        return replace(self, field_of_view=float(np.clip(radians, MIN_FIELD_OF_VIEW, MAX_FIELD_OF_VIEW)))


def pose_from_camera(
    camera: Camera,
    focus: Sequence[float] | Array,
    up: Array,
    size: tuple[int, int],
    room: tuple[float, float] | None = None,
) -> Pose:
    """Return the pose whose image of ``size`` (width, height) contains the whole image of ``camera``.

    If ``room`` is given, the image of ``camera`` fits into this (width, height) around the middle of the image.
    The pivot is the point on the viewing axis that is nearest to ``focus``. If this point is behind the camera, the
    pivot is 1 world unit in front of the camera.
    """
    height = size[1]
    room = size if room is None else room
    zoom = min(room[0] / camera.width, room[1] / camera.height)
    # A pose has a single focal length, because its pixels are square. The shorter of the camera's two focal lengths
    # avoids cropping.
    focal = zoom * float(min(camera.intrinsics[0, 0], camera.intrinsics[1, 1]))
    distance = float((np.asarray(focus, np.float64) - camera.centre) @ camera.forward)
    if not distance > _MIN_DISTANCE:
        distance = max(1.0, _MIN_DISTANCE)
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


def pose_facing(eye: Array, pivot: Array, up: Array, field_of_view: float) -> Pose:
    """Return the pose at ``eye`` that looks at ``pivot``, with ``up`` towards the top of the image."""
    camera = look_at(eye, pivot, up, np.eye(3), 1, 1)
    return Pose(pivot, camera.rotation, float(np.linalg.norm(pivot - eye)), field_of_view, up)


def interpolate_poses(start: Pose, end: Pose, fraction: float, *, is_eased: bool = True) -> Pose:
    """Interpolate from pose ``start`` to pose ``end`` at ``fraction`` in [0, 1], with smoothstep easing unless
    ``is_eased`` is False."""
    t = fraction * fraction * (3 - 2 * fraction) if is_eased else fraction
    if fraction >= 1:
        return end
    total = np.asarray(cv2.Rodrigues(end.rotation @ start.rotation.T)[0], np.float64).ravel()
    return Pose(
        pivot=start.pivot + t * (end.pivot - start.pivot),
        rotation=_nearest_rotation(_rotation_matrix(t * total) @ start.rotation),
        distance=float(np.exp((1 - t) * np.log(start.distance) + t * np.log(end.distance))),
        field_of_view=(1 - t) * start.field_of_view + t * end.field_of_view,
        up=end.up,
        offset=(
            (1 - t) * start.offset[0] + t * end.offset[0],
            (1 - t) * start.offset[1] + t * end.offset[1],
        ),
    )


def _rotation_matrix(vector: Array) -> Array:
    """Convert a rotation vector (3,), whose length is the angle in radians, to a rotation matrix."""
    return np.asarray(cv2.Rodrigues(np.ascontiguousarray(vector, np.float64))[0], np.float64)


def _nearest_rotation(rotation: Array) -> Array:
    """Return the rotation matrix that is nearest to ``rotation``.

    This removes the rounding errors that accumulate over thousands of small rotations.
    """
    left, _, right = np.linalg.svd(rotation)
    return left @ right
