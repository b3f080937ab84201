"""The fade of points at the near plane, in all players of scenes.

The near plane is at half the depth of the nearest surface that a camera of the capture sees
(:mod:`fourd.reconstruction.training.points.near_plane`), but a viewer can walk up to a wall between the cameras. If the
near plane removed points at once, each would disappear from one image to the next. Players therefore multiply the
density of a point, limited to 1, by

    clamp((z - near) / (FADE_SHARE * near), 0, 1)

where z is the camera depth of the point. A point fades from z = 1.5 near and is gone at z = near. In images from the
capture's cameras, no surface fades. Only a misplaced point can, such as a large disc beside a camera.

Training and evaluation (:func:`fourd.rendering.render_points`) cut points off at ``near`` without a fade. With a fade,
training could hide a misplaced point by moving it towards a camera, and evaluation would measure it less.

The same formula is in ``csrc/play/near_fade.h`` and ``viewer/web/shaders/points.glsl.js``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera

FADE_SHARE = 0.5
"""Depth over which a point fades, as a fraction of the depth of the near plane."""


def fade_near(
    xyz: NDArray[np.float32], density: NDArray[np.floating], camera: Camera, near: float
) -> NDArray[np.float32]:
    """Return the (N,) densities of points after the fade.

    Args:
        xyz: (N, 3) positions, world units.
        density: (N,) opacities at the centre. Opacities above 1 count as 1.
        camera: the viewer's camera.
        near: depth of the near plane in world units, above 0.
    """
    axis, offset = camera.rotation[2].astype(np.float32), np.float32(camera.translation[2])
    with np.errstate(all="ignore"):
        depth = axis[0] * xyz[:, 0] + axis[1] * xyz[:, 1] + axis[2] * xyz[:, 2] + offset
        fade = (depth - np.float32(near)) / (np.float32(FADE_SHARE) * np.float32(near))
    # Points without a finite depth are culled by the renderers, whatever their density.
    fade = np.clip(np.nan_to_num(fade, nan=0.0), 0, 1)
    return np.minimum(density.astype(np.float32), 1) * fade
