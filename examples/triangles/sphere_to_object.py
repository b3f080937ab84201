"""Deform a sphere to an aeroplane whose silhouettes are known from many viewpoints.

    python examples/triangles/sphere_to_object.py

The soft rasterizer (SoftRas, Liu et al. 2019) gives each vertex a gradient from the pixels around it. The sphere can
therefore grow wings, although its silhouettes do not cover the wings at first. The main term of the loss is 1 minus the
intersection over union of the soft and the given silhouettes. A Laplacian term and a term for the angles between
neighbouring triangles keep the surface smooth. The width of the soft edges shrinks during the fit. The program compares
the result with the true aeroplane in two ways: by the silhouettes from other viewpoints, and by the Chamfer distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from common import save
from shapes import Mesh, aeroplane, cameras_around, chamfer_distance, draw, mean_iou, shaded, sphere
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.reconstruction.meshes.surface.losses import MeshTopology, laplacian_loss, normal_consistency_loss
from fourd.rendering.triangles import rasterize_soft

FIRST_SIGMA, LAST_SIGMA = 3e-3, 1e-5
"""Sigma at the start and at the end of the fit. The soft edges are about sqrt(sigma) wide, in units of half of the
image's shorter side."""


@dataclass(frozen=True)
class Arguments:
    """Options of the fit."""

    views: int = 48
    """Number of viewpoints with a known silhouette."""
    size: int = 64
    """Width and height of the silhouettes, in pixels."""
    steps: int = 1000
    """Steps of Adam."""
    batch: int = 4
    """Viewpoints per step."""
    subdivisions: int = 3
    """Subdivisions of the icosahedron that approximates the sphere. Each subdivision quadruples the number of
    triangles."""
    laplacian: float = 10.0
    """Weight of the Laplacian term."""
    normal: float = 0.02
    """Weight of the term for the angles between neighbouring triangles."""
    seed: int = 0
    """Seed of the order of the viewpoints."""
    picture: Path = Path("sphere_to_object.png")
    """Output image: the sphere, the fitted mesh and the true mesh, from a viewpoint that the fit does not use."""


def main(arguments: Arguments) -> tuple[float, float]:
    """Fit the mesh. Returns the mean intersection over union in views that the fit does not use, and the Chamfer
    distance."""
    true, first = aeroplane(), sphere(arguments.subdivisions, 0.5)
    cameras = cameras_around(arguments.views, arguments.size)
    silhouettes = [draw(true, camera)[0] for camera in cameras]
    report("before", first, true)
    fitted = fit(first, cameras, silhouettes, arguments)
    scores = report("after", fitted, true)
    camera = cameras_around(7, 320, turn=0.5)[1]
    save([shaded(mesh, camera) for mesh in (first, fitted, true)], arguments.picture, bottom_up=False)
    return scores


def fit(first: Mesh, cameras: list[Camera], silhouettes: list[Tensor], arguments: Arguments) -> Mesh:
    """Move the vertices so that the soft silhouettes agree with ``silhouettes``, each (H, W)."""
    rng = np.random.default_rng(arguments.seed)
    topology = MeshTopology.of(first.tri, len(first.xyz))
    features = torch.ones(len(first.tri), 1)
    xyz = first.xyz.clone().requires_grad_()
    optimizer = torch.optim.Adam([xyz], lr=1e-2, betas=(0.9, 0.99))
    for step in range(arguments.steps):
        progress = step / arguments.steps
        optimizer.param_groups[0]["lr"] = 1e-2 * 0.05**progress
        sigma = FIRST_SIGMA * (LAST_SIGMA / FIRST_SIGMA) ** progress
        loss = arguments.laplacian * laplacian_loss(xyz, topology)
        loss = loss + arguments.normal * normal_consistency_loss(xyz, first.tri, topology)
        for view in rng.choice(len(cameras), arguments.batch, replace=False):
            _, alpha = rasterize_soft(xyz, first.tri, features, cameras[view], sigma=sigma)
            both = (alpha * silhouettes[view]).sum()
            loss = loss + (1 - both / (alpha.sum() + silhouettes[view].sum() - both)) / arguments.batch
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step % max(arguments.steps // 8, 1) == 0 or step == arguments.steps - 1:
            print(f"step {step}: loss {float(loss.detach()):.4f}, sigma {sigma:.1e}")
    return Mesh(xyz.detach(), first.tri)


def report(when: str, mesh: Mesh, true: Mesh) -> tuple[float, float]:
    """Print and return two scores: the mean intersection over union in 24 other views, and the Chamfer distance."""
    others = cameras_around(24, 128, turn=1.0)
    overlap = mean_iou(mesh, others, [draw(true, camera)[0] for camera in others])
    distance = chamfer_distance(mesh, true)
    print(f"{when}: intersection over union {overlap:.4f}, Chamfer distance {distance:.4f} (length of the object: 2)")
    return overlap, distance


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
