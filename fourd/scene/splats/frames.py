"""Conversion between the frames of a scene and Gaussian splats.

The alpha of a fourd point is ``density * (1 - d^2 / radius^2)`` at the distance d from its centre. Its integral over
the image equals that of a Gaussian splat with the same alpha at the centre and the standard deviation ``radius / 2``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.base.formats.ply import ColouredPoints
from fourd.rendering.ops.shade.harmonics import SH_CONSTANT, SH_TERMS
from fourd.scene.colour_fit import ColourFit
from fourd.scene.scene import BakedFrame, SceneManifest
from fourd.scene.splats.cloud import SplatCloud

RADIUS_PER_SCALE = 2.0
SPLAT_SH_BASE, SPLAT_SH_RANGE = 0.5, 16.0
"""Constants of the colour ``base + range * tanh(dot(sh, Y(d)))`` of frames that are made from splats, where Y(d) are
the spherical harmonics in the viewing direction d. The range is so large that the colour differs by less than 0.002
from the linear formula of splats, for colours in [-0.5, 1.5]."""
MAX_PIECES = 8
"""Maximum number of points by which one elongated splat is replaced."""
_SAMPLES = 4096
"""Number of coloured points that are sampled to measure the spacing of the points."""
_POINT_SCALE = 0.9
"""Standard deviation of the splats of coloured points, as a multiple of the median distance to the nearest
neighbour."""
MAX_HALF = float(np.finfo(np.float16).max)
_SPREAD = 2.4
"""Distance between the first and the last of the points that replace an elongated splat, as a multiple of the splat's
largest standard deviation."""


class SplatFit:
    """Converts frames of a scene to splats. The splats' colours are fitted by least squares."""

    def __init__(self, manifest: SceneManifest, degree: int) -> None:
        self._fit = ColourFit(manifest, _centred, degree)

    def convert(self, frame: BakedFrame) -> SplatCloud:
        """Return one round splat for each point that is not completely transparent."""
        sh = self._fit.fit(frame)
        radius, density = frame.radius.astype(np.float32), frame.density.astype(np.float32)
        kept = (radius > 0) & (density > 0)
        count = int(kept.sum())
        rotation = np.zeros((count, 4), np.float32)
        rotation[:, 0] = 1
        scale = np.repeat(radius[kept, None] / np.float32(RADIUS_PER_SCALE), 3, axis=1)
        return SplatCloud(frame.xyz[kept], scale, rotation, density[kept], sh[kept])


def cloud_from_points(points: ColouredPoints) -> SplatCloud:
    """Return round, opaque splats at coloured points, large enough to close the gaps between them."""
    from scipy.spatial import cKDTree

    xyz, rgb = points
    sample = xyz[:: max(len(xyz) // _SAMPLES, 1)]
    distances = np.asarray(cKDTree(xyz).query(sample, k=2)[0])[:, 1] if len(xyz) > 1 else np.ones(1)
    spacing = float(np.median(distances)) or 1e-3
    rotation = np.zeros((len(xyz), 4), np.float32)
    rotation[:, 0] = 1
    sh = np.asarray((rgb / 255 - SPLAT_SH_BASE) / SH_CONSTANT, np.float32)
    scale = np.full((len(xyz), 3), _POINT_SCALE * spacing, np.float32)
    return SplatCloud(xyz, scale, rotation, np.ones(len(xyz), np.float32), sh[..., None])


def frame_from_splats(cloud: SplatCloud) -> BakedFrame:
    """Return points that look like a cloud of splats, for a scene without source views.

    Because fourd's points are round, an elongated splat, whose longest axis is much longer than its middle axis, is
    replaced by several points along its longest axis. The shortest axis is ignored, so flat splats become thicker.
    """
    order = np.argsort(-cloud.scale, axis=1)
    scale = np.take_along_axis(cloud.scale, order, axis=1)
    longest = np.take_along_axis(_axes(cloud.rotation), order[:, None, :1], axis=2)[..., 0]
    pieces = np.clip(np.rint(scale[:, 0] / np.maximum(scale[:, 1], 1e-20)), 1, MAX_PIECES).astype(np.int64)
    source = np.repeat(np.arange(len(cloud)), pieces)
    index = np.arange(len(source)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    count = pieces[source]
    position = np.where(count > 1, index / np.maximum(count - 1, 1) - 0.5, 0.0) * _SPREAD
    shift = (position * scale[source, 0])[:, None] * longest[source]
    with np.errstate(over="ignore"):  # The radius is clipped later.
        radius = RADIUS_PER_SCALE * np.where(count > 1, scale[source, 1], np.sqrt(scale[source, 0] * scale[source, 1]))
    sh = np.zeros((len(source), 3, SH_TERMS), np.float32)
    sh[..., : cloud.sh.shape[-1]] = cloud.sh[source] / SPLAT_SH_RANGE
    return BakedFrame(
        xyz=(cloud.xyz[source] + shift).astype(np.float32),
        radius=np.clip(radius, 0, MAX_HALF).astype(np.float16),
        density=np.clip(cloud.opacity[source], 0, 1).astype(np.float16),
        sh=np.clip(sh, -MAX_HALF, MAX_HALF).astype(np.float16),
        blend_weights=np.zeros((len(source), 0), np.float16),
        rgb=np.zeros((len(source), 0, 3), np.uint8),
    )


def _centred(colour: NDArray[np.float32]) -> NDArray[np.float32]:
    return colour - np.float32(SPLAT_SH_BASE)


def _axes(rotation: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the rotation matrices (N, 3, 3) of unit quaternions (w, x, y, z). Their columns are the axes of the
    splats."""
    from scipy.spatial.transform import Rotation

    if len(rotation) == 0:
        return np.zeros((0, 3, 3))
    return np.asarray(Rotation.from_quat(rotation[:, [1, 2, 3, 0]].astype(np.float64)).as_matrix())
