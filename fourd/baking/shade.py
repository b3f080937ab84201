"""Colours of a baked frame's points seen from a camera: blended source views and spherical harmonics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.baking.scene import BakedFrame, SceneManifest
from fourd.cameras import Camera, nearest_views
from fourd.ops.shade.op import shade_points
from fourd.ops.shade.reference import shade_points_reference
from fourd.ops.shade.shading import Shading


def shade(frame: BakedFrame, camera: Camera, manifest: SceneManifest, *, threads: int = 0) -> NDArray[np.float32]:
    """Compute the RGB of every point as ``camera`` sees it, (N, 3) float32, not clamped.

    The source views are those of :func:`select_source_views`; see :func:`fourd.ops.shade.op.shade_points` for the
    formula.

    Args:
        frame: finite, as :class:`fourd.baking.container.SceneReader` guarantees.
        threads: 0 uses FOURD_THREADS if set, else all cores.
    """
    arrays = (frame.xyz, frame.sh, frame.blend_weights, frame.rgb)
    return shade_points(*arrays, make_shading(camera, manifest), threads=threads)


def shade_reference(frame: BakedFrame, camera: Camera, manifest: SceneManifest) -> NDArray[np.float32]:
    """Compute what :func:`shade` specifies, in NumPy: slower, and obvious."""
    arrays = (frame.xyz, frame.sh, frame.blend_weights, frame.rgb)
    return shade_points_reference(*arrays, make_shading(camera, manifest))


def make_shading(camera: Camera, manifest: SceneManifest) -> Shading:
    """Collect what the kernels need to shade a scene's points for ``camera``."""
    views = np.asarray(select_source_views(camera, manifest), dtype=np.int32)
    return Shading(views, np.ascontiguousarray(camera.centre), manifest.sh_range, manifest.sh_base)


def select_source_views(camera: Camera, manifest: SceneManifest) -> list[int]:
    """Return the indices of the ``manifest.neighbours`` source views nearest to ``camera`` by angle at the focus.

    Empty for a scene without source views.
    """
    sources = list(manifest.source_cameras)
    return nearest_views(camera, sources, manifest.neighbours, np.asarray(manifest.focus))
