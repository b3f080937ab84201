"""The floor: the plane on which the subject's shadow lies.

A point of the floor that is in shadow is darker than in the empty scene, by the same factor in all cameras that see it.
A point of the subject is not: each camera sees another part of the background behind it. Points of which nearly all
cameras say the same are therefore on the floor, even if the floor has no texture at all. Around a subject that stands,
they lie in a plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Array, Camera
from fourd.recording.matting.shadows.observed_light import ObservedLight
from fourd.recording.stereo.plane_hypotheses import find_large_planes

Floats = NDArray[np.float32]

MIN_VIEWS = 4
"""A point is compared only if at least this many cameras see it."""
MAX_SPREAD = 0.06
"""Cameras agree about a point if the light that they see differs from the median by at most this."""
MIN_AGREEING = 0.85
"""Fraction of the cameras that see a point of a shadow, and must agree about it."""
DARKEST, BRIGHTEST = 0.4, 0.9
"""Range of the light of points by which the floor is found. Darker points may be black parts of the subject."""
MIN_POINTS = 60
MIN_SHARE = 0.2
"""Fraction of all points of shadows that must lie in the plane."""
MAX_BEHIND = 0.25
"""Fraction of the subject's box that may lie behind the plane. A larger part is behind a plane that cuts the
subject."""
MAX_CANDIDATES = 4000


@dataclass(frozen=True, eq=False)
class Floor:
    """A plane in world coordinates.

    Attributes:
        normal: (3,) unit vector towards the cameras.
        offset: distance of the plane from the origin along the normal, in world units.
    """

    normal: Array
    offset: float


def shaded_points(xyz: Array, pixels: NDArray[np.int32], views: Sequence[ObservedLight]) -> Array:
    """Return those of the points ``xyz`` (N, 3) of which nearly all cameras say that they are background in shadow.

    Args:
        xyz: points in world units.
        pixels: (C, N) flat pixel index, row * width + column, of each point in each camera, or -1 if the camera does
            not see it.
        views: the light in the image of each camera.
    """
    light = np.stack([_sample(view.light, at) for view, at in zip(views, pixels, strict=True)])
    shaded = np.stack([_sample(view.is_shaded, at) for view, at in zip(views, pixels, strict=True)])
    known = np.stack([_sample(view.is_known, at) for view, at in zip(views, pixels, strict=True)])
    typical = median_of(light, shaded)
    agree = shaded & (np.abs(light - typical) < MAX_SPREAD)
    seen = known.sum(axis=0)
    chosen = (seen >= MIN_VIEWS) & (agree.sum(axis=0) >= MIN_AGREEING * seen)
    return xyz[chosen & (typical > DARKEST) & (typical < BRIGHTEST)]


def find_floor(
    points: Array, cameras: Sequence[Camera], corners: Array, tolerance: float, rng: np.random.Generator
) -> Floor | None:
    """Find the plane in which most of the ``points`` (N, 3) of shadows lie.

    Args:
        points: points of shadows in world units.
        cameras: the cameras, which are on one side of the floor.
        corners: (2, 3) lower and upper corner of the subject's box.
        tolerance: maximum distance of the plane's points from it, in world units.
        rng: random generator.

    Returns:
        the floor, or None if the points are too few, or are not in one plane below the subject.
    """
    if len(points) < MIN_POINTS:
        return None
    some = points if len(points) <= MAX_CANDIDATES else points[rng.integers(0, len(points), MAX_CANDIDATES)]
    centres = np.stack([camera.centre for camera in cameras])
    box = corners[0] + rng.random((1000, 3)) * (corners[1] - corners[0])
    for *direction, distance in find_large_planes(some, np.ones(len(some)), tolerance, rng):
        normal, offset = np.asarray(direction), float(distance)
        if centres[0] @ normal < offset:
            normal, offset = -normal, -offset
        near = np.count_nonzero(np.abs(points @ normal - offset) < tolerance)
        is_common = near >= max(MIN_POINTS, MIN_SHARE * len(points))
        if is_common and (centres @ normal > offset).all() and np.mean(box @ normal < offset) <= MAX_BEHIND:
            return Floor(normal, offset)
    return None


def median_of(values: Floats, chosen: NDArray[np.bool_]) -> Floats:
    """Return the lower median over the first axis of those values (C, ...) that are ``chosen``; infinity where none
    is."""
    ordered = np.sort(np.where(chosen, values, np.float32(np.inf)), axis=0)
    middle = np.maximum(chosen.sum(axis=0) - 1, 0) // 2
    return np.take_along_axis(ordered, middle[None], axis=0)[0]


def _sample(picture: NDArray[np.generic], at: NDArray[np.int32]) -> NDArray[np.generic]:
    """Return the values (N,) of a picture (h, w) at flat pixel indices (N,), and 0 for the index -1."""
    return np.where(at >= 0, picture.ravel()[np.maximum(at, 0)], picture.dtype.type(0))
