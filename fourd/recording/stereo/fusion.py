"""Fusion of depth maps by geometric consistency between images.

A cell is one sample of a depth map and stores a plane in space. The support of a cell is the number of other images
that confirm its depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fourd.base.cameras import Camera
from fourd.recording.stereo.patches import index_intrinsics
from fourd.recording.stereo.patchmatch import DepthMap

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MIN_SCORE = 0.6
"""Minimum photometric score of a cell."""
DEPTH_TOLERANCE = 0.01
"""A point lies on a surface if their relative depth difference is less than this value."""
REPROJECTION_TOLERANCE_PX = 1.5
"""Maximum forward-backward error in pixels. To compute it, a cell's centre is projected into another image, and that
image's surface point at this pixel is projected back into the cell's image. The error is the distance between the
result and the cell's centre."""
OCCLUSION_MARGIN = 0.03
"""Relative depth difference above which a point in front of a known surface occludes it."""
ITERATIONS = 3
MIN_COMPONENT_CELLS = 25
"""Minimum number of cells in a connected component. Components with fewer cells are outliers."""
CONTINUITY_TOLERANCE = 0.03
"""Two neighbouring cells are connected if the plane of one cell predicts the inverse depth of the other with a relative
error below this value."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A depth map that also records which cells are known and how many other images confirm each cell.

    Attributes:
        camera: pinhole camera of the image.
        depths: depth map with N cells.
        known: (N,) bool, true for cells with a valid plane.
        support: (N,) number of other images that confirm the cell. The support of extrapolated cells is 0.
    """

    camera: Camera
    depths: DepthMap
    known: Bools
    support: NDArray[np.intp]

    def world(self, xy: Array, inverse_depth: Array) -> Array:
        """Compute the world points (M, 3) at pixel indices (M, 2) with inverse depths (M,)."""
        rays = np.column_stack([xy, np.ones(len(xy))]) @ np.linalg.inv(index_intrinsics(self.camera)).T
        return np.asarray((rays / inverse_depth[:, None] - self.camera.translation) @ self.camera.rotation, np.float64)

    def points(self, cells: NDArray[np.intp]) -> Array:
        """Compute the world points (M, 3) at the centres of the cells with the indices ``cells`` (M,)."""
        xy = self.depths.grid.pixels[cells, :2].astype(np.float64)
        return self.world(xy, self.depths.inverse_depth[cells].astype(np.float64))

    def project(self, xyz: Array) -> Projection:
        """Project world points (M, 3) into the image, and compare their depths with those of the surface."""
        pixels, depth = self.camera.project(xyz)
        xy = pixels - 0.5
        grid = self.depths.grid
        cells = np.where(depth > 0, grid.cells_at(xy), -1)
        inverse = (self.depths.planes[cells] * np.column_stack([xy, np.ones(len(xy))])).sum(axis=1)
        known = (cells >= 0) & self.known[cells]
        return Projection(xy, cells, np.where(known, inverse * depth, np.nan), np.where(known, inverse, np.nan))


@dataclass(frozen=True, eq=False)
class Projection:
    """Projections of M world points into the image of a surface.

    Attributes:
        xy: (M, 2) pixel indices.
        cells: (M,) index of the depth-map cell, or -1 outside the image.
        ratio: (M,) depth of the point divided by the depth of the surface, or NaN if the surface is unknown.
        inverse_depth: (M,) inverse depth of the surface, or NaN if the surface is unknown.
    """

    xy: Array
    cells: NDArray[np.intp]
    ratio: Array
    inverse_depth: Array

    @property
    def on_surface(self) -> Bools:
        """(M,) bool, true for points that lie on the surface."""
        return np.abs(self.ratio - 1) < DEPTH_TOLERANCE

    @property
    def occludes(self) -> Bools:
        """(M,) bool, true for points that occlude the surface."""
        return self.ratio < 1 - OCCLUSION_MARGIN


def fuse_depth_maps(cameras: Sequence[Camera], maps: Sequence[DepthMap]) -> list[Surface]:
    """Remove those cells of depth maps that are inconsistent with other depth maps.

    A cell is kept if the number of other images that confirm it is at least 1 and exceeds the number of images whose
    known surface it occludes. One confirmation is enough, because often only two cameras see a wall. This causes some
    errors: on such a wall, one in 60 cells has a wrong depth that is nevertheless confirmed. Connected components of
    fewer than 25 cells are removed.
    """
    surfaces = [
        Surface(camera, depths, depths.scores > MIN_SCORE, np.zeros(len(depths.scores), np.intp))
        for camera, depths in zip(cameras, maps, strict=True)
    ]
    for number in range(ITERATIONS):
        surfaces = [_filter_consistent(index, surfaces, number > 0) for index in range(len(surfaces))]
    return [replace(surface, known=_large_components(surface.depths, surface.known)) for surface in surfaces]


def _filter_consistent(index: int, surfaces: Sequence[Surface], strict: bool) -> Surface:
    """Keep the cells that at least one other surface confirms.

    If ``strict`` is true, the number of surfaces that confirm a kept cell must also exceed the number of surfaces that
    the cell occludes.
    """
    surface = surfaces[index]
    cells = np.flatnonzero(surface.known)
    agreeing, occluded = count_agreement(index, surfaces, cells)
    known, support = np.zeros_like(surface.known), np.zeros_like(surface.support)
    known[cells] = (agreeing > 0) & (occluded < agreeing) if strict else agreeing > 0
    support[cells] = agreeing
    return replace(surface, known=known, support=support)


def count_agreement(
    index: int, surfaces: Sequence[Surface], cells: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """For each of the ``cells`` (M,) of the surface ``surfaces[index]``, count the other surfaces that agree with the
    cell, and the other surfaces that the cell would occlude.

    Returns:
        agreeing: (M,) number of other surfaces that agree with the cell. A surface agrees if its depth matches and if
            the cell's centre, projected into the surface's image and back, returns to about the same position.
        occluded: (M,) number of other surfaces that the cell would occlude.
    """
    surface = surfaces[index]
    xyz = surface.points(cells)
    agreeing, occluded = np.zeros(len(cells), np.intp), np.zeros(len(cells), np.intp)
    for other in (*surfaces[:index], *surfaces[index + 1 :]):
        projection = other.project(xyz)
        agrees = projection.on_surface
        back, _ = surface.camera.project(other.world(projection.xy[agrees], projection.inverse_depth[agrees]))
        distance = np.linalg.norm(back - 0.5 - surface.depths.grid.pixels[cells[agrees], :2], axis=1)
        agrees[agrees] = distance < REPROJECTION_TOLERANCE_PX
        agreeing += agrees
        occluded += projection.occludes
    return agreeing, occluded


def _large_components(depths: DepthMap, known: Bools) -> Bools:
    """Return an (N,) bool mask of the known cells whose connected component has at least 25 cells.

    Neighbouring cells are connected if the plane of one predicts the depth of the other.
    """
    numbers = np.arange(len(known)).reshape(depths.grid.shape)
    neighbours = (
        (numbers[:, :-1], numbers[:, 1:]),
        (numbers[:-1], numbers[1:]),
        (numbers[:-1, :-1], numbers[1:, 1:]),
        (numbers[1:, :-1], numbers[:-1, 1:]),
    )
    first, second = (np.concatenate([pair[end].ravel() for pair in neighbours]) for end in (0, 1))
    both = known[first] & known[second]
    first, second = first[both], second[both]
    linked = np.zeros(len(first), bool)
    for a, b in ((first, second), (second, first)):
        extrapolated = np.einsum("nc,nc->n", depths.planes[a], depths.grid.pixels[b])
        linked |= np.abs(extrapolated / depths.inverse_depth[b] - 1) < CONTINUITY_TOLERANCE
    links = coo_array((linked[linked], (first[linked], second[linked])), shape=(len(known),) * 2)
    _, labels = connected_components(links, directed=False)
    return known & (np.bincount(labels)[labels] >= MIN_COMPONENT_CELLS)
