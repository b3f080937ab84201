"""Opaque meshes with vertex colours, and their differentiable rendering."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.reconstruction.meshes.views import clip_positions
from fourd.rendering.triangles import antialias, antialias_construct_topology, interpolate, rasterize
from fourd.rendering.triangles.antialiasing import Topology

SAMPLES = 2
"""Number of samples per pixel along each axis during the fit."""


@dataclass(frozen=True, eq=False)
class ColouredMesh:
    """An opaque triangle mesh with a colour at each vertex. Both sides of the triangles are visible.

    Attributes:
        xyz: (V, 3) float32 vertices in world units.
        triangles: (M, 3) int32 vertex indices, counter-clockwise seen from outside.
        rgb: (V, 3) uint8 colours.
    """

    xyz: NDArray[np.float32]
    triangles: NDArray[np.int32]
    rgb: NDArray[np.uint8]


def render_opaque(
    xyz: Tensor, rgb: Tensor, tri: Tensor, camera: Camera, topology: Topology | None = None, samples: int = SAMPLES
) -> tuple[Tensor, Tensor]:
    """Render a mesh on a black background, with a depth buffer and antialiased edges.

    Args:
        xyz: (V, 3) float32 vertices in world units.
        rgb: (V, 3) vertex colours, which are interpolated linearly within a triangle.
        tri: (M, 3) int32 vertex indices.
        camera: pinhole camera.
        topology: the triangles' neighbours, or None to compute them in this call.
        samples: number of samples per pixel along each axis.

    Returns:
        rgb (H, W, 3) and alpha (H, W), differentiable with respect to vertices and colours. Gradients at the silhouette
        come from the antialiased edges.
    """
    fine = camera.resize(camera.width * samples, camera.height * samples)
    clip = clip_positions(xyz, fine)[None].contiguous()
    rast, _ = rasterize(clip, tri, (fine.height, fine.width), grad_db=False)
    image, _ = interpolate(torch.nn.functional.pad(rgb, (0, 1), value=1.0)[None], rast, tri)
    image = antialias(image, rast.detach(), clip, tri, topology)
    image = image.reshape(camera.height, samples, camera.width, samples, 4).mean(dim=(1, 3))
    return image[..., :3], image[..., 3]


@torch.no_grad()
def mesh_image(mesh: ColouredMesh, camera: Camera, samples: int = 3) -> NDArray[np.float32]:
    """Render a mesh on a black background to an image (H, W, 3) in [0, 1]."""
    rgb = torch.from_numpy(mesh.rgb).float() / 255
    tri = torch.from_numpy(mesh.triangles)
    topology = antialias_construct_topology(tri)
    image, _ = render_opaque(torch.from_numpy(mesh.xyz), rgb, tri, camera, topology, samples)
    return np.asarray(image.clamp(0, 1).numpy(), np.float32)
