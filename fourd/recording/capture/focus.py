"""The common focus of a ring of cameras, which is the point that the cameras face, and poses that lack one because they
are stored in the wrong direction or mirrored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera

Array = NDArray[np.float64]

PARALLEL = 1e-4
"""Optical axes count as parallel if the mean squared sine of their angles to their common direction is below this
value.

The value corresponds to an angle of 0.6 degrees.
"""
LOOSE_MISS = 0.5
"""A camera faces a point in a loose sense if the tangent of the angle between its axis and the direction to the point
is at most this value."""
CLOSE_MISS = 0.2
MIN_DEPTH = 0.05
"""Minimum distance of a faced point, as a fraction of the largest distance between two cameras."""
MAX_FACING = 0.75
"""The axes of poses do not meet if fewer than this fraction of the cameras face their common focus, in a loose
sense."""
MIN_SPREAD_DEG = 30.0
"""The axes of the inverse poses must differ by at least this angle. Nearly parallel axes always meet somewhere."""
SURE_SPREAD_DEG = 60.0
SURE_CAMERAS = 4
SURE_UPRIGHT = 0.2
"""The evidence is sure only if the upward axes of the inverse poses agree better than those of the poses, because
cameras are mostly upright. The lengths of their mean axes must differ by at least this value."""
COLLAPSED_SIZE = 0.1
COLLAPSED_UPRIGHT = 0.5
"""Cameras that stand at nearly the same place and look in nearly the same direction, but are turned about their axes by
very different angles, do not exist. Their size is below COLLAPSED_SIZE of that of the inverse poses, and the length of
their mean upward axis is below COLLAPSED_UPRIGHT. Poses of upright cameras around the origin have this form if they are
stored as camera-to-world."""


def find_focus(cameras: Sequence[Camera]) -> Array | None:
    """Find the world point (3,) nearest to all optical axes (least squares); return None if the axes are parallel."""
    return _nearest_point(
        np.stack([camera.centre for camera in cameras]), np.stack([camera.forward for camera in cameras])
    )


def viewing_centre(cameras: Sequence[Camera]) -> Array:
    """Compute the world point (3,) with the smallest sum of squared distances to the cameras' optical axes, or the mean
    camera centre if the axes are parallel."""
    centres = np.stack([camera.centre for camera in cameras])
    projectors = np.stack([np.eye(3) - np.outer(camera.forward, camera.forward) for camera in cameras])
    normal = projectors.sum(axis=0)
    if np.linalg.cond(normal) > 1e8:
        return np.asarray(centres.mean(axis=0))
    return np.asarray(np.linalg.solve(normal, np.einsum("nij,nj->i", projectors, centres)))


def median_distance(cameras: Sequence[Camera], point: Array) -> float:
    """Return the median distance of the cameras from a world point (3,), in world units."""
    return float(np.median([np.linalg.norm(camera.centre - point) for camera in cameras]))


def _nearest_point(centres: Array, axes: Array) -> Array | None:
    projections = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    if np.linalg.eigvalsh(projections.mean(axis=0))[0] < PARALLEL:
        return None
    return np.linalg.lstsq(projections.sum(axis=0), np.einsum("nij,nj->i", projections, centres), rcond=None)[0]


def is_reflection(rotation: Array) -> bool:
    """Return whether a (3, 3) matrix mirrors: its determinant is negative."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.linalg.det(rotation) < 0)


@dataclass(frozen=True)
class InvertedPoses:
    """Evidence that camera-to-world poses are stored where world-to-camera poses are expected.

    Attributes:
        reason: what was found, as part of a sentence.
        is_sure: whether the evidence is strong enough to refuse the poses.
    """

    reason: str
    is_sure: bool


def camera_to_world_hint(rotations: Array, translations: Array) -> InvertedPoses | None:
    """Find out whether poses were probably stored as camera-to-world.

    They were if the optical axes do not meet in front of the cameras, or all cameras stand at one place, but the axes
    of the inverse poses meet: cameras around a scene face a common point. Cameras that look outwards, or stand side by
    side, have neither property.

    Args:
        rotations: (N, 3, 3) rotations or reflections, taken as world-to-camera.
        translations: (N, 3) translations, taken as world-to-camera.

    Returns:
        the evidence, or None if there is none.
    """
    if len(rotations) < 2:
        return None
    centres = -np.einsum("nji,nj->ni", rotations, translations)
    far = float(np.linalg.norm(translations, axis=1).max())
    axes = rotations[:, :, 2]
    spread = _spread_deg(axes)
    if spread < MIN_SPREAD_DEG or not _facing(translations, axes, far, CLOSE_MISS).all():
        return None
    given_up, inverse_up = (float(np.linalg.norm(up.mean(axis=0))) for up in (rotations[:, 1], rotations[:, :, 1]))
    is_collapsed = (
        _size(centres) < COLLAPSED_SIZE * _size(translations)
        and given_up < COLLAPSED_UPRIGHT
        and _spread_deg(rotations[:, 2]) < SURE_SPREAD_DEG
    )
    if not is_collapsed and _facing(centres, rotations[:, 2], far, LOOSE_MISS).mean() >= MAX_FACING:
        return None
    found = "all cameras stand at nearly one place" if is_collapsed else "the optical axes of the cameras do not meet"
    reason = (
        f"{found}, but the optical axes of the inverse poses meet in front of all {len(axes)} cameras, as if "
        "camera-to-world poses were stored where world-to-camera poses are expected"
    )
    is_sure = len(axes) >= SURE_CAMERAS and spread >= SURE_SPREAD_DEG and inverse_up - given_up >= SURE_UPRIGHT
    return InvertedPoses(reason, is_sure)


def describe_inverted(cameras: Sequence[Camera]) -> InvertedPoses | None:
    """Find out whether the poses of cameras were probably stored as camera-to-world; see
    :func:`camera_to_world_hint`."""
    if len(cameras) < 2:
        return None
    return camera_to_world_hint(
        np.stack([camera.rotation for camera in cameras]), np.stack([camera.translation for camera in cameras])
    )


def _size(centres: Array) -> float:
    """Return the largest distance between two of the positions (N, 3)."""
    return float(np.linalg.norm(centres[:, None] - centres[None], axis=2).max())


def _spread_deg(axes: Array) -> float:
    """Return the largest angle in degrees between two of the unit vectors (N, 3)."""
    return float(np.degrees(np.arccos(np.clip((axes @ axes.T).min(), -1, 1))))


def _facing(centres: Array, axes: Array, far: float, miss: float) -> NDArray[np.bool_]:
    """Return which cameras (N,) face the point nearest to all axes; all of them if the axes are parallel.

    ``far`` is the distance of the farthest camera from the origin, which limits the precision of the positions.
    """
    focus = _nearest_point(centres, axes)
    if focus is None:
        return np.ones(len(centres), np.bool_)
    to_focus = focus - centres
    depth = np.einsum("ni,ni->n", to_focus, axes)
    distance = np.linalg.norm(to_focus - depth[:, None] * axes, axis=1)
    return np.asarray((depth > max(MIN_DEPTH * _size(centres), 1e-6 * far)) & (distance <= miss * depth), np.bool_)
