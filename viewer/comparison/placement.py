"""Where a captured picture is in the image of the window's camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fourd.base.cameras import Camera
from fourd.viewer.interface.layout import Area
from fourd.viewer.loaded_scene import LoadedScene
from fourd.viewer.navigation.pose import Pose

_SAME_ROTATION, _SAME_PLACE = 1e-4, 1e-4
"""Largest differences between entries of rotation matrices, and between positions as a share of the distance to the
pivot, at which two cameras show the same view. A view that was stored as JSON differs by less."""


def area_of_picture(view: Camera, shown: Camera) -> Area:
    """Return the area that the whole image of ``view`` covers in the image of ``shown``, in pixels.

    Both cameras are at the same place and look in the same direction, see :func:`same_view`.
    """
    scale = np.diag(shown.intrinsics)[:2] / np.diag(view.intrinsics)[:2]
    left, top = shown.intrinsics[:2, 2] - scale * view.intrinsics[:2, 2]
    return Area(float(left), float(top), float(scale[0] * view.width), float(scale[1] * view.height))


def same_view(view: Camera, shown: Camera, distance: float) -> bool:
    """Return whether two cameras have the same place and direction. ``distance`` is that of the pivot."""
    is_turned = np.abs(view.rotation - shown.rotation).max() > _SAME_ROTATION
    return not is_turned and float(np.linalg.norm(view.centre - shown.centre)) <= _SAME_PLACE * distance


def find_view(cameras: Sequence[Camera], shown: Camera, distance: float, preferred: int) -> int | None:
    """Return the index of the camera whose view is shown, or None if it is that of no camera. If several cameras have
    this view, it is the camera ``preferred``, if it is one of them."""
    order = [preferred, *range(len(cameras))] if preferred < len(cameras) else range(len(cameras))
    return next((index for index in order if same_view(cameras[index], shown, distance)), None)


def find_view_of_pose(scene: LoadedScene, pose: Pose, size: tuple[int, int], preferred: int = 0) -> int | None:
    """Return the index of the camera of the capture whose view ``pose`` is, as :func:`find_view` does, in a window of
    ``size`` (width, height) pixels."""
    return find_view(scene.manifest.cameras, pose.camera(*size), pose.distance, preferred)


def compared_area(free: Area, mode: str) -> Area:
    """Return the area in whose middle the picture of the other scene is: the left half of the free area side by side,
    or the whole free area on the left of a line."""
    return free.split(0.5)[0] if mode == "side by side" else free


def fitted(size: tuple[int, int], room: Area) -> Area:
    """Return the largest area with the proportions of ``size`` in the middle of ``room``."""
    zoom = min(room.width / size[0], room.height / size[1])
    width, height = zoom * size[0], zoom * size[1]
    x, y = room.centre
    return Area(x - width / 2, y - height / 2, width, height)
