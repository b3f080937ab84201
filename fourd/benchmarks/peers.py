"""The benchmark computations in other libraries, for comparison.

These libraries are optional.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.benchmarks.timing import Work


def missing_peers() -> list[str]:
    """Return the names of all libraries that are needed for the comparisons on the CPU but are not installed."""
    return [name for name in ("pytorch3d", "embreex") if find_spec(name) is None]


def pytorch3d_compositor(cloud: dict[str, Tensor], view: Camera, layers: int, backward: bool) -> Work | None:
    """Return a function that runs PyTorch3D's point rasterizer and alpha compositor.

    Returns None if PyTorch3D is not installed.
    """
    try:
        rasterizer: Any = import_module("pytorch3d.renderer.points.rasterize_points")
        structures: Any = import_module("pytorch3d.structures")
        compositor: Any = import_module("pytorch3d.renderer.compositing")
    except ImportError:
        return None
    focal = float(view.intrinsics[1, 1])
    rotation = torch.from_numpy(view.rotation).float()
    translation = torch.from_numpy(view.translation).float()
    size = torch.tensor([view.width, view.height], dtype=torch.float32)

    def work() -> object:
        free = {name: array.requires_grad_(backward) for name, array in cloud.items()}
        xyz_camera = free["xyz"] @ rotation.T + translation
        depth = xyz_camera[:, 2:]
        pixels = xyz_camera @ torch.from_numpy(view.intrinsics[:2].T).float() / depth
        # In PyTorch3D, normalized coordinates point left and up, and the shorter side of the image has length 2.
        normalized = torch.cat([(size - 2 * pixels) / size.min(), depth], dim=1)
        radius = (2 * focal / size.min()) * free["radius"] / depth[:, 0]
        clouds = structures.Pointclouds(points=[normalized], features=[free["features"]])
        found, _, squares = rasterizer.rasterize_points(
            clouds, (view.height, view.width), radius.detach(), points_per_pixel=layers
        )
        falloff = 1 - squares / radius[found.clamp(min=0)] ** 2
        alpha = (free["density"][found.clamp(min=0)] * falloff).clamp(min=0) * (found >= 0)
        image = compositor.alpha_composite(
            found.long().permute(0, 3, 1, 2), alpha.permute(0, 3, 1, 2), free["features"].T
        )
        return torch.autograd.grad(image.sum(), list(free.values())) if backward else image

    return work


def pytorch3d_rasterizer(pos: Tensor, tri: Tensor, side: int) -> Work | None:
    """Return a function that rasterizes the triangles ``tri`` with PyTorch3D, with one triangle per pixel and without
    gradients. ``pos`` (V, 4) are the clip coordinates of the vertices.

    Returns None if PyTorch3D is not installed.
    """
    try:
        rasterizer: Any = import_module("pytorch3d.renderer.mesh.rasterize_meshes")
        structures: Any = import_module("pytorch3d.structures")
    except ImportError:
        return None
    # In PyTorch3D, normalized coordinates point left and up, and depth is the distance along the optical axis.
    vertices = torch.cat([-pos[:, :2] / pos[:, 3:], pos[:, 3:]], 1)
    mesh = structures.Meshes([vertices], [tri.long()])
    settings = {"blur_radius": 0.0, "faces_per_pixel": 1, "bin_size": 0, "perspective_correct": True}
    return lambda: rasterizer.rasterize_meshes(mesh, (side, side), **settings)


def gsplat_rasterizer(cloud: dict[str, Tensor], view: Camera, backward: bool) -> Work | None:
    """Return a function that runs gsplat's rasterizer. Returns None if gsplat is not installed.

    For comparable timings, each point becomes an isotropic Gaussian that gsplat truncates at the point's radius. The
    cloud must be on a CUDA device, because gsplat supports only CUDA.
    """
    try:
        rendering: Any = import_module("gsplat.rendering")
    except ImportError:
        return None
    count, device = cloud["xyz"].shape[0], cloud["xyz"].device
    view_matrix = torch.eye(4, device=device)
    view_matrix[:3, :3] = torch.from_numpy(view.rotation)
    view_matrix[:3, 3] = torch.from_numpy(view.translation)
    intrinsics = torch.from_numpy(view.intrinsics).float().to(device)
    identity_quaternion = torch.tensor([1.0, 0, 0, 0], device=device).expand(count, 4)

    def work() -> object:
        free = {name: array.requires_grad_(backward) for name, array in cloud.items()}
        # The scale is a third of the radius, because gsplat truncates a Gaussian at three standard deviations.
        scales = (free["radius"] / 3)[:, None].expand(count, 3)
        image, alpha, _ = rendering.rasterization(
            free["xyz"],
            identity_quaternion,
            scales,
            free["density"],
            free["features"],
            view_matrix[None],
            intrinsics[None],
            view.width,
            view.height,
        )
        return torch.autograd.grad(image.sum() + alpha.sum(), list(free.values())) if backward else image

    return work


def embree_tracer(xyz: Tensor, tri: Tensor, origins: Tensor, directions: Tensor) -> Work | None:
    """Return a function that finds the nearest hits of rays with Embree, which the package embreex runs on one thread.

    Returns None if embreex is not installed.
    """
    try:
        core: Any = import_module("embreex.rtcore_scene")
        mesh: Any = import_module("embreex.mesh_construction")
    except ImportError:
        return None
    scene = core.EmbreeScene()
    mesh.TriangleMesh(scene, xyz[tri.long()].numpy())
    rays = origins.numpy(), directions.numpy()
    return lambda: scene.run(*rays)
