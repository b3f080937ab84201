"""Objects with known geometry, cameras around these objects, and functions that measure the error of a mesh. The
examples that reconstruct shapes use this module."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from fourd.base.cameras import Camera, look_at
from fourd.reconstruction.meshes.surface.grid import box_grid
from fourd.reconstruction.meshes.surface.losses import triangle_normals
from fourd.reconstruction.meshes.surface.marching import marching_tetrahedra
from fourd.reconstruction.meshes.views import clip_positions
from fourd.rendering.triangles import Topology, antialias, antialias_construct_topology, interpolate, rasterize

AEROPLANE = (
    ((0.0, 0.0, 0.0), (1.0, 0.17, 0.17)),  # fuselage
    ((0.1, 0.0, 0.0), (0.26, 0.95, 0.07)),  # wings
    ((-0.8, 0.0, 0.05), (0.15, 0.42, 0.06)),  # tailplane
    ((-0.82, 0.0, 0.2), (0.15, 0.06, 0.28)),  # fin
    ((0.35, 0.0, 0.1), (0.25, 0.12, 0.14)),  # cockpit
)
"""Centres and half axes of the ellipsoids of an aeroplane that flies along x, with z up."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Vertices xyz (V, 3) float32, and triangles tri (T, 3) int32, counter-clockwise seen from outside."""

    xyz: Tensor
    tri: Tensor


def aeroplane(cells: int = 64) -> Mesh:
    """Return an aeroplane of length 2: a smooth union of ellipsoids, extracted from a grid with at least
    ``cells`` cubes along its longest side."""
    grid = box_grid(np.array([-1.05, -1.05, -0.25]), np.array([1.05, 1.05, 0.55]), cells)
    parts = []
    for centre, half_axes in AEROPLANE:
        offset, axes = grid.xyz - torch.tensor(centre), torch.tensor(half_axes)
        norm = (offset / axes).norm(dim=1)
        # First-order approximation of the distance from the ellipsoid, positive inside.
        parts.append((1 - norm) * norm / (offset / axes**2).norm(dim=1).clamp_min(1e-6))
    sdf = torch.stack(parts).mul(60).logsumexp(dim=0) / 60
    surface = marching_tetrahedra(grid.xyz, sdf, grid.tetrahedra)
    return Mesh(surface.xyz, surface.triangles.int())


def torus() -> Mesh:
    """Return a tilted torus with an outer radius of 0.9."""
    mesh = trimesh.creation.torus(major_radius=0.65, minor_radius=0.25, major_sections=96, minor_sections=48)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.6, [1, 0.4, 0]))
    return of_trimesh(mesh)


def sphere(subdivisions: int, radius: float) -> Mesh:
    """Return a sphere around the origin: an icosahedron that is subdivided ``subdivisions`` times."""
    return of_trimesh(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius))


def of_trimesh(mesh: trimesh.Trimesh) -> Mesh:
    """Return the mesh as tensors."""
    return Mesh(torch.from_numpy(np.array(mesh.vertices)).float(), torch.from_numpy(np.array(mesh.faces)).int())


def cameras_around(count: int, size: int, turn: float = 0.0) -> list[Camera]:
    """Return cameras that look at the origin from the distance 4, in nearly uniform directions (a Fibonacci lattice).

    An object of length 2 covers about 80% of the image. ``turn`` rotates the cameras around z, in radians.
    """
    index = np.arange(count)
    z = 0.95 * (1 - (2 * index + 1) / count)
    longitude = turn + index * np.pi * (3 - np.sqrt(5))
    xy = np.sqrt(1 - z**2)
    centres = 4 * np.stack([xy * np.cos(longitude), xy * np.sin(longitude), z], axis=1)
    K = np.array([[1.6 * size, 0, size / 2], [0, 1.6 * size, size / 2], [0, 0, 1]])
    return [look_at(centre, np.zeros(3), np.array([0.0, 0, 1]), K, width=size, height=size) for centre in centres]


def draw(mesh: Mesh, camera: Camera, topology: Topology | None = None) -> tuple[Tensor, Tensor]:
    """Return the antialiased silhouette (H, W) of a mesh, and its camera depth (H, W). Outside the mesh, the depth is
    0.

    To save time if a mesh is drawn several times, pass the ``topology`` of its triangles.
    """
    pos = clip_positions(mesh.xyz, camera)[None].contiguous()
    rast, _ = rasterize(pos, mesh.tri, (camera.height, camera.width), grad_db=False)
    silhouette = antialias((rast.detach()[..., 3:] > 0).float(), rast, pos, mesh.tri, topology)
    # The last clip coordinate of a perspective projection is the depth.
    depth, _ = interpolate(pos[..., 3:].contiguous(), rast, mesh.tri)
    return silhouette[0, ..., 0], depth[0, ..., 0]


def shaded(mesh: Mesh, camera: Camera) -> Tensor:
    """Return an image (H, W, 3) of a mesh on white. The shades of grey depend on the normals of the triangles."""
    light = torch.nn.functional.normalize(torch.tensor([0.4, -0.5, 0.8]), dim=0)
    shade = 0.55 + 0.4 * (triangle_normals(mesh.xyz, mesh.tri) @ light)
    pos = clip_positions(mesh.xyz, camera)[None].contiguous()
    rast, _ = rasterize(pos, mesh.tri, (camera.height, camera.width), grad_db=False)
    same = torch.arange(len(mesh.tri), dtype=torch.int32)[:, None].repeat(1, 3)
    grey, _ = interpolate(shade[:, None], rast, same)
    grey = torch.where(rast[..., 3:] > 0, grey, torch.ones_like(grey))
    return antialias(grey, rast, pos, mesh.tri)[0].expand(-1, -1, 3)


def mean_iou(mesh: Mesh, cameras: list[Camera], silhouettes: list[Tensor]) -> float:
    """Return the mean intersection over union of the mesh's silhouettes and ``silhouettes``, each (H, W). A pixel is
    covered if its value is above 0.5."""
    ratios, topology = [], antialias_construct_topology(mesh.tri)
    for camera, silhouette in zip(cameras, silhouettes, strict=True):
        a, b = draw(mesh, camera, topology)[0] > 0.5, silhouette > 0.5
        ratios.append(float((a & b).sum() / (a | b).sum().clamp(min=1)))
    return float(np.mean(ratios))


def chamfer_distance(mesh: Mesh, true: Mesh) -> float:
    """Return the mean distance of random points on one mesh from the other mesh, averaged over both directions.

    The distance to a mesh is computed as the distance to the nearest of 300,000 random points on this mesh. The result
    for two equal meshes with an area of 6 is therefore 0.002 instead of 0.
    """
    few = [random_points(m, 2_000, seed=0) for m in (mesh, true)]
    many = [cKDTree(random_points(m, 300_000, seed=1)) for m in (true, mesh)]
    return float(np.mean([tree.query(points)[0].mean() for points, tree in zip(few, many, strict=True)]))


def random_points(mesh: Mesh, count: int, seed: int) -> NDArray[np.float64]:
    """Return random points (count, 3) on a mesh, uniformly distributed over its area."""
    surface = trimesh.Trimesh(mesh.xyz.numpy(), mesh.tri.numpy(), process=False)
    return np.asarray(trimesh.sample.sample_surface(surface, count, seed=seed)[0])
