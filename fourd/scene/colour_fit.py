"""Fitting of spherical harmonics to the colours of a scene.

For each point, spherical harmonics are fitted by least squares to the point's colours in the capture's cameras and in
cameras between them. Directions from which the point is visible have the largest weights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at, nearest_views
from fourd.rendering.ops.points.arrays import point_visibility_numpy
from fourd.rendering.ops.shade.harmonics import SH_CONSTANT, directional_terms
from fourd.scene.scene import BakedFrame, SceneManifest
from fourd.scene.shade import shade

MIN_WEIGHT = 0.02
"""In the fit, the weight of a direction is this number plus the visibility, in [0, 1], of the point from that
direction."""
RIDGE = (1e-4, 3e-2, 1e-1, 2e-1)
"""Regularisation weights of the squared coefficients of degree 0 to 3, relative to the sum of the weights of all
directions. They keep the coefficients from fitting noise."""
DIRECTIONS = 24
"""Number of viewpoints used for a scene without cameras."""
_CHUNK = 8192
_NEIGHBOURS = 2

Link = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""Converts colours to the values that the harmonics approximate."""


class ColourFit:
    """Fits spherical harmonics to the colours of a scene's point clouds.

    Args:
        manifest: the manifest of the scene.
        link: converts a colour to the value that ``sum(coefficient * Y(direction))`` approximates, where Y are the
            spherical harmonics.
        degree: largest degree of the harmonics, 0 to 3.
    """

    def __init__(self, manifest: SceneManifest, link: Link, degree: int = 2) -> None:
        self.manifest = manifest
        self.link = link
        self.degree = degree
        self.cameras = viewpoints(manifest)

    @property
    def terms(self) -> int:
        """Number of spherical harmonics per colour channel."""
        return (self.degree + 1) ** 2

    def fit(self, cloud: BakedFrame) -> NDArray[np.float32]:
        """Return the coefficients (N, 3, terms) of the N points of ``cloud``."""
        if cloud.point_count == 0 or not self.cameras:
            return np.zeros((cloud.point_count, 3, self.terms), np.float32)
        return self._solve(cloud.xyz, *self._observe(cloud))

    def _observe(self, cloud: BakedFrame) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the values to be fitted, (C, N, 3), and their weights, (C, N), for C cameras."""
        targets, weights = [], []
        radius, density = cloud.radius.astype(np.float32), cloud.density.astype(np.float32)
        for camera in self.cameras:
            targets.append(self.link(shade(cloud, camera, self.manifest)))
            visible = point_visibility_numpy(
                cloud.xyz, radius, density, camera, layers=self.manifest.layers, near=self.manifest.near
            )
            weights.append(visible + np.float32(MIN_WEIGHT))
        return np.stack(targets), np.stack(weights)

    def _solve(
        self, xyz: NDArray[np.float32], targets: NDArray[np.float32], weights: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Solve the weighted least-squares problem of every point. Returns (N, 3, terms)."""
        degrees = np.arange(self.degree + 1)
        ridge = np.diag(np.repeat(RIDGE[: self.degree + 1], 2 * degrees + 1)).astype(np.float32)
        centres = np.stack([camera.centre for camera in self.cameras])
        out = np.empty((len(xyz), 3, self.terms), np.float32)
        for first in range(0, len(xyz), _CHUNK):
            chunk = slice(first, first + _CHUNK)
            direction = xyz[chunk] - centres[:, None]
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            terms = directional_terms(*np.moveaxis(direction.astype(np.float32), -1, 0))[: self.terms - 1]
            constant = np.full(direction.shape[:2], SH_CONSTANT, np.float32)
            basis = np.stack([constant, *terms], axis=-1)
            weighted = basis * weights[:, chunk, None]
            normal = np.einsum("cni,cnj->nij", weighted, basis, optimize=True)
            right = np.einsum("cni,cnk->nik", weighted, targets[:, chunk], optimize=True)
            scale = weights[:, chunk].sum(axis=0)[:, None, None]
            out[chunk] = np.linalg.solve(normal + ridge * scale, right).transpose(0, 2, 1)
        return out


def viewpoints(manifest: SceneManifest) -> tuple[Camera, ...]:
    """Return the cameras for which the colours of a scene are evaluated.

    These are the cameras of the source views, and cameras halfway between neighbouring ones. If the scene has no source
    views, all its cameras take the place of the source views. For a scene without cameras, the result is cameras on a
    sphere around the scene.
    """
    cameras = manifest.source_cameras or manifest.cameras
    if cameras:
        return (*cameras, *between(cameras, np.asarray(manifest.focus)))
    return _all_sides(manifest)


def between(cameras: Sequence[Camera], focus: NDArray[np.float64]) -> list[Camera]:
    """Return cameras halfway between each camera and its nearest cameras, without duplicates.

    The new cameras look at ``focus``, and each has the intrinsics of one of its two neighbours.
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


def _all_sides(manifest: SceneManifest) -> tuple[Camera, ...]:
    """Return cameras on a sphere around the scene's bounding box. Their centres form a spherical Fibonacci lattice."""
    lower, upper = (np.asarray(corner) for corner in manifest.bounds)
    centre, radius = (lower + upper) / 2, max(float(np.linalg.norm(upper - lower)), 1e-3)
    size, intrinsics = 256, np.array([[256.0, 0, 128], [0, 256.0, 128], [0, 0, 1]])
    found = []
    for index in range(DIRECTIONS):
        height = 1 - (2 * index + 1) / DIRECTIONS
        angle = np.pi * (3 - np.sqrt(5)) * index
        ring = np.sqrt(1 - height**2)
        side = np.array([ring * np.cos(angle), ring * np.sin(angle), height])
        up = np.array([0.0, 0.0, 1.0]) if ring > 0.1 else np.array([1.0, 0.0, 0.0])
        found.append(look_at(centre + 1.5 * radius * side, centre, up, intrinsics, size, size))
    return tuple(found)
