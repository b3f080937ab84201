"""Light scenes: all colour as low-degree spherical harmonics, fitted to what the full scene shows.

For each point, the colours that the full scene shows from the capture's cameras, and from cameras between them, are
approximated by least squares. Directions in which the point is visible count most.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fourd.baking.scene import BakedFrame, SceneManifest
from fourd.baking.shade import shade
from fourd.cameras import Camera, look_at, nearest_views
from fourd.ops.points.arrays import point_visibility_numpy
from fourd.ops.shade.harmonics import SH_CONSTANT, SH_TERMS, directional_terms

LIGHT_SH_BASE, LIGHT_SH_RANGE = 0.5, 1.0
"""Constants of the colour ``base + range * tanh(sh . Y(d))`` in light scenes."""
TERMS = 9
"""Number of spherical harmonics that are fitted, of degree 0 to 2."""
MIN_WEIGHT = 0.02
"""Weight of a direction in which the point is not visible. A visible point has a weight of up to 1."""
RIDGE = (1e-4, 3e-2, 1e-1)
"""Weight of the squared coefficients of degree 0, 1 and 2, so that they do not fit noise."""
MAX_TANH = 0.95
_CHUNK = 8192
_NEIGHBOURS = 2


class LightFit:
    """Fits the points of a scene's clouds."""

    def __init__(self, manifest: SceneManifest) -> None:
        self.manifest = manifest
        sources = manifest.source_cameras
        self.cameras = (*sources, *between(sources, np.asarray(manifest.focus)))

    def convert(self, cloud: BakedFrame) -> BakedFrame:
        """Return the cloud without source views, and with the fitted spherical harmonics."""
        points = cloud.point_count
        sh = np.zeros((points, 3, SH_TERMS), np.float16)
        if points and self.cameras:
            sh[..., :TERMS] = self._fit(cloud.xyz, *self._observe(cloud))
        weights, rgb = np.zeros((points, 0), np.float16), np.zeros((points, 0, 3), np.uint8)
        return replace(cloud, sh=sh, blend_weights=weights, rgb=rgb)

    def _observe(self, cloud: BakedFrame) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the values to fit (C, N, 3), which are colours before tanh, and the weights (C, N) of C cameras."""
        targets, weights = [], []
        radius, density = cloud.radius.astype(np.float32), cloud.density.astype(np.float32)
        for camera in self.cameras:
            colour = shade(cloud, camera, self.manifest)
            scaled = np.clip((colour - LIGHT_SH_BASE) / LIGHT_SH_RANGE, -MAX_TANH, MAX_TANH)
            targets.append(np.arctanh(scaled))
            visible = point_visibility_numpy(
                cloud.xyz, radius, density, camera, layers=self.manifest.layers, near=self.manifest.near
            )
            weights.append(visible + np.float32(MIN_WEIGHT))
        return np.stack(targets), np.stack(weights)

    def _fit(
        self, xyz: NDArray[np.float32], targets: NDArray[np.float32], weights: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Solve the weighted least squares of every point. Returns (N, 3, TERMS)."""
        ridge = np.diag(np.repeat(RIDGE, (1, 3, 5))).astype(np.float32)
        centres = np.stack([camera.centre for camera in self.cameras])
        out = np.empty((len(xyz), 3, TERMS), np.float32)
        for first in range(0, len(xyz), _CHUNK):
            chunk = slice(first, first + _CHUNK)
            direction = xyz[chunk] - centres[:, None]
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            terms = directional_terms(*np.moveaxis(direction.astype(np.float32), -1, 0))[: TERMS - 1]
            basis = np.stack([np.full_like(terms[0], SH_CONSTANT), *terms], axis=-1)
            weighted = basis * weights[:, chunk, None]
            normal = np.einsum("cni,cnj->nij", weighted, basis, optimize=True)
            right = np.einsum("cni,cnk->nik", weighted, targets[:, chunk], optimize=True)
            scale = weights[:, chunk].sum(axis=0)[:, None, None]
            out[chunk] = np.linalg.solve(normal + ridge * scale, right).transpose(0, 2, 1)
        return out


def between(cameras: tuple[Camera, ...], focus: NDArray[np.float64]) -> list[Camera]:
    """Return cameras halfway between each camera and its nearest cameras, without duplicates.

    The new cameras look at ``focus`` and have the intrinsics of one of their two neighbours.
    """
    pairs = set()
    for index, camera in enumerate(cameras):
        near = nearest_views(camera, cameras, _NEIGHBOURS + 1, focus)
        pairs |= {(min(index, other), max(index, other)) for other in near if other != index}
    found = []
    for one, other in sorted(pairs):
        a, b = cameras[one], cameras[other]
        centre, up = (a.centre + b.centre) / 2, -(a.rotation[1] + b.rotation[1])
        if np.linalg.norm(np.cross(focus - centre, up)) > 1e-6:
            found.append(look_at(centre, focus, up, a.intrinsics, a.width, a.height))
    return found
