"""Finds the points of a cloud that are visible in at least one view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.points.arrays import point_visibility_numpy
from fourd.scene.colour_fit import viewpoints
from fourd.scene.scene import BakedFrame, SceneManifest


def find_visible(cloud: BakedFrame, manifest: SceneManifest, least: float) -> NDArray[np.int64]:
    """Return the indices, in ascending order, of the points whose visibility is at least ``least`` in at least one
    view.

    The views are those of :func:`fourd.scene.colour_fit.viewpoints`: the source views, and views halfway between
    neighbouring source views. The visibility of a point is in [0, 1]. The background does not hide dynamic points.
    """
    if least <= 0 or cloud.point_count == 0:
        return np.arange(cloud.point_count)
    radius, density = cloud.radius.astype(np.float32), cloud.density.astype(np.float32)
    visible = np.zeros(cloud.point_count, np.float32)
    for camera in viewpoints(manifest):
        weights = point_visibility_numpy(cloud.xyz, radius, density, camera, layers=manifest.layers, near=manifest.near)
        np.maximum(visible, weights, out=visible)
    return np.flatnonzero(visible >= least)
