"""Moves camera paths into the room of the cameras, or nearer to a small subject."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.convex_hull import distance_to_hull

if TYPE_CHECKING:
    from fourd.scene.playable import Bounds

Array = NDArray[np.float64]

ROOM_MARGIN = 0.95
"""Largest distance of a path from the focus, as a fraction of the distance to the convex hull of the cameras."""
MIN_ROOM_SHARE = 0.5
"""A path is moved into the convex hull of the cameras only if it keeps at least this fraction of its distance. The hull
of a ring of cameras is flat, and no room."""
FILLED_SHARE = 0.8
"""Share of the width or the height of an image that a framed subject fills."""
MAX_FRAMED_SHARE = 0.75
"""A path is moved to a subject only if it keeps at most this fraction of its distance."""


def keep_in_room(path: Sequence[Camera], cameras: Sequence[Camera], focus: Sequence[float] | Array) -> list[Camera]:
    """Move the cameras of a path towards ``focus``, all by the same factor, into the convex hull of ``cameras``.

    Cameras all around a scene usually hang on the walls of a room, and the median distance of cameras in a box leads
    through its walls. The path is returned unchanged if the cameras do not surround the focus: if their hull does not
    contain it, or if the path would have to come nearer than MIN_ROOM_SHARE of its distance.
    """
    centre = np.asarray(focus, dtype=np.float64)
    offsets = np.stack([camera.centre for camera in path]) - centre
    distances = np.maximum(np.linalg.norm(offsets, axis=1), 1e-12)
    walls = distance_to_hull(offsets / distances[:, None], np.stack([camera.centre for camera in cameras]), centre)
    factor = min(1.0, ROOM_MARGIN * float((walls / distances).min()))
    if factor < MIN_ROOM_SHARE:
        return list(path)
    return _moved(path, centre + factor * offsets)


def frame_subject(path: Sequence[Camera], focus: Sequence[float] | Array, bounds: Bounds) -> list[Camera]:
    """Move a path around ``focus`` to the centre of a small subject, and nearer, all cameras by the same factor, so
    that the box of the subject fills FILLED_SHARE of the width or of the height of an image.

    The cameras of a laboratory are far from the subject, which would fill a few percent of the images. The path is
    returned unchanged if it would keep more than MAX_FRAMED_SHARE of its distance: the subject is large enough, and the
    images then keep the resolution of the recording.
    """
    lower, upper = np.asarray(bounds[0], np.float64), np.asarray(bounds[1], np.float64)
    offsets = np.stack([camera.centre for camera in path]) - np.asarray(focus, np.float64)
    distances = np.maximum(np.linalg.norm(offsets, axis=1), 1e-12)
    middle = (lower + upper) / 2
    corners = np.stack(np.meshgrid(*zip(lower, upper, strict=True))).reshape(3, 8).T - middle
    factors = []
    for camera, distance in zip(path, distances, strict=True):
        x, y, depth = camera.rotation @ corners.T
        wide = 2 * camera.intrinsics[0, 0] * np.abs(x) / (FILLED_SHARE * camera.width)
        high = 2 * camera.intrinsics[1, 1] * np.abs(y) / (FILLED_SHARE * camera.height)
        factors.append(float((np.maximum(wide, high) - depth).max()) / distance)
    factor = max(factors)
    if not 0 < factor <= MAX_FRAMED_SHARE:
        return list(path)
    return _moved(path, middle + factor * offsets)


def _moved(path: Sequence[Camera], centres: Array) -> list[Camera]:
    """Return the cameras at other centres (N, 3)."""
    return [
        Camera(camera.intrinsics, camera.rotation, -camera.rotation @ at, camera.width, camera.height)
        for camera, at in zip(path, centres, strict=True)
    ]
