"""Fitting of a signed distance function and vertex offsets to the mattes and images of one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import nearest_views
from fourd.reconstruction.meshes.fitting.hull_distance import DistanceGrid
from fourd.reconstruction.meshes.fitting.photo import MIN_COSINE, PhotoView, photo_loss
from fourd.reconstruction.meshes.fitting.settings import FitSettings
from fourd.reconstruction.meshes.surface.losses import (
    MeshTopology,
    laplacian_loss,
    normal_consistency_loss,
    triangle_normals,
)
from fourd.reconstruction.meshes.surface.marching import Surface, marching_tetrahedra
from fourd.reconstruction.meshes.views import MeshView, clip_positions, depth_image
from fourd.rendering.ops.meshes.ids import decode_ids
from fourd.rendering.triangles import antialias, interpolate, rasterize

MAX_OFFSET_CELLS = 0.4
"""Maximum offset of a grid vertex along each axis, in units of the side length of the cubes from which the tetrahedral
grid is built. This limit keeps each vertex near its position in the undeformed grid, where neighbouring vertices are at
least 0.87 cube sides apart."""

DEPTH_STEPS = 20
"""Number of gradient steps after which the depth images of all views are rendered again. The depth images determine
which surface points each view sees."""

NO_DEPTH = 1e9
"""Depth of pixels that show no surface."""


@dataclass(frozen=True, eq=False)
class FittedMesh:
    """A fitted surface.

    Attributes:
        xyz: (N, 3) float32 vertices in world units.
        triangles: (M, 3) int64 vertex indices, counter-clockwise seen from outside.
        losses: (S,) float64 total loss, the weighted sum of all loss terms, in each of the S gradient steps.
    """

    xyz: NDArray[np.float32]
    triangles: NDArray[np.int64]
    losses: NDArray[np.float64]


def fit_mesh(start: DistanceGrid, views: Sequence[MeshView], settings: FitSettings) -> FittedMesh:
    """Fit the surface of one frame.

    The parameters are a signed distance and an offset for each vertex of a tetrahedral grid (DMTet, Shen et al. 2021).
    Each step renders the mesh into one view, called the target view. The silhouette term compares the rendered,
    antialiased alpha with the target view's matte. The photo term compares the colours of the target view's pixels with
    the colours that other views show at the same surface points. The Laplacian term and the normal term keep the
    surface smooth. The signed distances on the border of the grid keep their signs, so that the surface stays closed.

    Args:
        start: initial signed distances, for example the distances to the visual hull.
        views: views of the frame, at least 2.
        settings: steps, rates and weights.

    Raises:
        ValueError: if there are fewer than 2 views, or ``start`` contains no surface.
    """
    if len(views) < 2:
        raise ValueError(f"views: expected at least 2, got {len(views)}")
    fit = _Fit(start, views, settings)
    losses = [fit.step(step) for step in range(settings.steps)]
    with torch.no_grad():
        surface = fit.surface()
    return FittedMesh(surface.xyz.numpy(), surface.triangles.numpy(), np.array(losses, np.float64))


class _Fit:
    """Parameters, optimiser and views of one fit."""

    def __init__(self, start: DistanceGrid, views: Sequence[MeshView], settings: FitSettings) -> None:
        self.grid, self.settings = start.grid, settings
        self.side = start.grid.side
        # Distances of exactly 0 would produce triangles without area.
        distance = start.sdf / self.side
        self.distance = torch.where(distance.abs() < 1e-3, torch.full_like(distance, 1e-3), distance)
        self.border_sign = torch.where(self.distance > 0, 1.0, -1.0)[start.grid.is_border]
        self.distance.requires_grad_()
        self.offset = torch.zeros_like(start.grid.xyz).requires_grad_()
        if len(self.surface().triangles) == 0:
            raise ValueError("start: expected distances of both signs, got a grid without a surface")
        self.optimizer = torch.optim.Adam([self.distance, self.offset], lr=settings.rate)
        self.views = [_to_photo_view(view) for view in views]
        self.neighbours = _nearby_views(views, settings.sources, self.grid.xyz.mean(dim=0).numpy())
        self.generator = torch.Generator().manual_seed(settings.seed)
        self.order: list[int] = []

    def surface(self) -> Surface:
        """Return the surface for the current parameters, which is differentiable with respect to them."""
        reach = MAX_OFFSET_CELLS * self.side
        xyz = self.grid.xyz + reach * torch.tanh(self.offset)
        return marching_tetrahedra(xyz, self.distance, self.grid.tetrahedra)

    def step(self, step: int) -> float:
        """Perform one gradient step, and return the loss."""
        settings = self.settings
        for group in self.optimizer.param_groups:
            group["lr"] = settings.rate * 0.1 ** (step / max(settings.steps - 1, 1))
        surface = self.surface()
        if step % DEPTH_STEPS == 0:
            self._render_depths(surface)
        if not self.order:
            self.order = torch.randperm(len(self.views), generator=self.generator).tolist()
        target = self.order.pop()
        loss = self._image_terms(surface, target) + self._smoothness(surface)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        with torch.no_grad():
            border = self.grid.is_border
            self.distance[border] = self.border_sign * (self.distance[border] * self.border_sign).clamp(min=0.05)
        return float(loss.detach())

    def _image_terms(self, surface: Surface, target: int) -> Tensor:
        view = self.views[target]
        clip = clip_positions(surface.xyz, view.camera)[None].contiguous()
        triangles = surface.triangles.int()
        rast, _ = rasterize(clip, triangles, (view.camera.height, view.camera.width), grad_db=False)
        covered = (rast.detach()[..., 3:] > 0).float()
        alpha = antialias(covered, rast, clip, triangles)[0, ..., 0]
        loss = self.settings.silhouette * (alpha - view.matte).square().sum() / view.matte.sum().clamp(min=1)
        if self.settings.photo == 0:
            return loss
        xyz, _ = interpolate(surface.xyz[None], rast, triangles)
        normals = triangle_normals(surface.xyz.detach(), triangles)[decode_ids(rast.detach()[0, ..., 3]).long()]
        centre = torch.from_numpy(view.camera.centre.astype(np.float32))
        rays = torch.nn.functional.normalize(centre - xyz[0].detach(), dim=-1)
        compared = (covered[0, ..., 0] > 0) & (view.matte > 0.99) & ((rays * normals).sum(dim=-1) > MIN_COSINE)
        sources = [self.views[index] for index in self.neighbours[target]]
        return loss + self.settings.photo * photo_loss(
            xyz[0][compared], normals[compared], compared.nonzero(), view, sources
        )

    def _smoothness(self, surface: Surface) -> Tensor:
        topology = MeshTopology.of(surface.triangles, len(surface.xyz))
        laplacian = laplacian_loss(surface.xyz / self.side, topology)
        normal = normal_consistency_loss(surface.xyz, surface.triangles, topology)
        return self.settings.laplacian * laplacian + self.settings.normal * normal

    def _render_depths(self, surface: Surface) -> None:
        xyz = surface.xyz.detach()
        for index, view in enumerate(self.views):
            depth = torch.from_numpy(depth_image(xyz, surface.triangles, view.camera)).clamp(max=NO_DEPTH)
            self.views[index] = replace(view, depth=depth[None, None])


def _to_photo_view(view: MeshView) -> PhotoView:
    camera = view.camera
    matrices = (np.array(value, np.float32) for value in (camera.rotation, camera.translation, camera.intrinsics))
    rotation, translation, intrinsics = (torch.from_numpy(matrix) for matrix in matrices)
    rgb = torch.from_numpy(np.ascontiguousarray(view.rgb.transpose(2, 0, 1)))[None]
    matte = torch.from_numpy(view.matte)
    return PhotoView(
        camera, rgb, matte, torch.full_like(matte, NO_DEPTH)[None, None], rotation, translation, intrinsics
    )


def _nearby_views(views: Sequence[MeshView], count: int, focus: NDArray[np.float32]) -> list[list[int]]:
    """Return, for each view, the indices of the ``count`` other views that are nearest to it. The distance between two
    views is the angle at ``focus`` (3,) between the directions to their cameras."""
    cameras = [view.camera for view in views]
    ordered = [nearest_views(camera, cameras, len(cameras), focus.astype(np.float64)) for camera in cameras]
    return [[other for other in order if other != index][:count] for index, order in enumerate(ordered)]
