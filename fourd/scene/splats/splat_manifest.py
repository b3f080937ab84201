"""Metadata of scenes that are made from splats, whose files state neither cameras nor bounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.scene.scene import SceneManifest, to_triple
from fourd.scene.splats.cloud import SplatCloud
from fourd.scene.splats.frames import SPLAT_SH_BASE, SPLAT_SH_RANGE
from fourd.scene.splats.surrounding_cameras import cameras_around

SPLAT_LAYERS = 48
"""Maximum number of points that are composited per pixel. It is higher than for fourd's points, because splats are less
opaque."""
OUTLIERS = 2.0
"""Percentage of the splats that lie beyond each of the six sides of the bounds."""


def splat_manifest(
    cloud: SplatCloud, up: NDArray[np.float64], numbers: Sequence[int], counts: Sequence[int], producer: str
) -> SceneManifest:
    """Return the metadata of a scene without source views, with cameras around the splats.

    Args:
        cloud: the splats of a frame, at least one.
        up: (3,) unit vector of the up direction.
        numbers: the numbers of the frames.
        counts: number of splats of each frame.
        producer: what made the splats.
    """
    lower, upper, focus = _extent(cloud.xyz)
    diagonal = max(float(np.linalg.norm(upper - lower)), 1e-6)
    cameras = cameras_around(focus, diagonal, up)
    return SceneManifest(
        source_names=(),
        source_cameras=(),
        focus=to_triple(focus),
        bounds=(to_triple(lower), to_triple(upper)),
        frame_numbers=tuple(numbers),
        points=tuple(counts),
        other_names=tuple(f"side {index + 1}" for index in range(len(cameras))),
        other_cameras=cameras,
        layers=SPLAT_LAYERS,
        sh_base=SPLAT_SH_BASE,
        sh_range=SPLAT_SH_RANGE,
        near=1e-3 * diagonal,
        producer=producer,
    )


def _extent(xyz: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the lower and upper corner of a box that contains most of the splats, and their median position."""
    points = xyz.astype(np.float64)
    lower, middle, upper = np.percentile(points, [OUTLIERS, 50, 100 - OUTLIERS], axis=0)
    return lower, upper, middle
