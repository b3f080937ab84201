"""Colours of a baked frame's points for a camera, from blended source views and spherical harmonics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, SelectedViews, select_views
from fourd.rendering.ops.shade.op import shade_points
from fourd.rendering.ops.shade.reference import shade_points_reference
from fourd.rendering.ops.shade.shading import Shading
from fourd.scene.scene import BakedFrame, SceneManifest


def shade(frame: BakedFrame, camera: Camera, manifest: SceneManifest, *, threads: int = 0) -> NDArray[np.float32]:
    """Compute the RGB colour of every point as seen by ``camera``, (N, 3) float32. Colours are not clamped.

    The source views are those that :func:`select_source_views` selects. The formula is in
    :func:`fourd.rendering.ops.shade.op.shade_points`.

    Args:
        frame: a frame whose values are all finite; :class:`fourd.scene.container.SceneReader` checks this.
        threads: number of threads. 0 means the environment variable FOURD_THREADS, or all cores if it is not set.
    """
    arrays = (frame.xyz, frame.sh, frame.blend_weights, frame.rgb)
    return shade_points(*arrays, make_shading(camera, manifest), threads=threads)


def shade_reference(frame: BakedFrame, camera: Camera, manifest: SceneManifest) -> NDArray[np.float32]:
    """Compute the same colours as :func:`shade`, with a slow, simple NumPy implementation."""
    arrays = (frame.xyz, frame.sh, frame.blend_weights, frame.rgb)
    return shade_points_reference(*arrays, make_shading(camera, manifest))


def make_shading(camera: Camera, manifest: SceneManifest) -> Shading:
    """Return the inputs from which the kernels compute the colours of a scene's points for ``camera``."""
    views = select_source_views(camera, manifest)
    indices = np.asarray(views.indices, dtype=np.int32)
    centre = np.ascontiguousarray(camera.centre)
    return Shading(indices, views.weights, centre, manifest.sh_range, manifest.sh_base)


def select_source_views(camera: Camera, manifest: SceneManifest) -> SelectedViews:
    """Select the ``manifest.neighbours`` source views with the smallest angles to ``camera``, as seen from the focus.

    If a scene has no source views, none are selected.
    """
    focus = np.asarray(manifest.focus)
    return select_views(camera, manifest.source_cameras, manifest.neighbours, focus, fade=manifest.fade_views)
