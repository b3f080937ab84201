"""Finds the place of a scene that a pixel shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.scene import BakedFrame

_MIN_RADIUS_PX = 3.0
"""Points count as hit up to this distance, so that the user need not hit a tiny disc exactly."""
_MIN_DENSITY = 0.3
"""Fainter points are haze, which does not hide what is behind it."""


def pick(frame: BakedFrame, camera: Camera, pixel: tuple[float, float], near: float) -> NDArray[np.float64] | None:
    """Return the position (3,) in world units that a pixel shows, or None if it shows no point.

    Args:
        frame: the points.
        camera: the camera of the image.
        pixel: position (x, y) in the image; the centre of the upper left pixel is (0.5, 0.5).
        near: depth of the near plane, before which points are not drawn.
    """
    pixels, depth = camera.project(frame.xyz)
    is_visible = (depth > near) & (frame.density > _MIN_DENSITY)
    if not is_visible.any():
        return None
    radius = camera.intrinsics[1, 1] * frame.radius.astype(np.float64) / np.where(is_visible, depth, 1.0)
    distance = np.linalg.norm(pixels - np.asarray(pixel), axis=1)
    is_hit = is_visible & (distance <= np.maximum(radius, _MIN_RADIUS_PX))
    if not is_hit.any():
        return None
    # The centre of the nearest disc may be several pixels beside the mouse, but its depth is that of the surface.
    nearest = float(depth[is_hit].min())
    found = camera.unproject(np.asarray([pixel], np.float64), np.asarray([nearest]))
    return np.asarray(found, np.float64)[0]
