"""Move a rectangle onto a distant target with the soft rasterizer.

    python examples/triangles/soft_rectangle.py

The rectangle and the target do not overlap at first, so a hard rasterizer gives no gradient that moves the rectangle
towards the target. In the soft rasterizer (SoftRas, Liu et al. 2019), every triangle contributes to every pixel. The
contribution decreases with the distance of the pixel from the triangle, and sigma determines how fast. Sigma shrinks
during the fit, so that the final edges are sharp. The target is rendered with the same sigma. If the target were sharp,
the rectangle would shrink to nothing, because all its pixels are wrong and no pixel of the target is near.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from common import save
from torch import Tensor

from fourd.base.cameras import Camera, look_at
from fourd.rendering.triangles import rasterize_soft

FIRST_SIGMA, LAST_SIGMA = 1.0, 1e-6
"""Sigma at the start and at the end of the fit. The soft edges are about sqrt(sigma) wide, in units of half of the
image's shorter side."""


@dataclass(frozen=True)
class Arguments:
    """Options of the fit."""

    size: int = 64
    """Width and height of the image, in pixels."""
    steps: int = 300
    """Steps of Adam."""
    picture: Path = Path("soft_rectangle.png")
    """Output image: the target, the first rectangle and the fitted rectangle."""


def main(arguments: Arguments) -> float:
    """Fit centre and size of the rectangle. Returns the final intersection over union with the target."""
    camera = front_camera(arguments.size)
    true = torch.tensor([0.45, 0.4, 0.3, 0.2])
    first = torch.tensor([-0.5, -0.45, 0.15, 0.35])
    shape = first.clone().requires_grad_()
    optimizer = torch.optim.Adam([shape], lr=2e-2)
    for step in range(arguments.steps):
        progress = step / arguments.steps
        sigma = FIRST_SIGMA * (LAST_SIGMA / FIRST_SIGMA) ** progress
        target = render(true, camera, sigma).detach()
        loss = (render(shape, camera, sigma) - target).square().mean()
        optimizer.param_groups[0]["lr"] = 2e-2 * 0.05**progress
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step % max(arguments.steps // 5, 1) == 0 or step == arguments.steps - 1:
            print(f"step {step}: sigma {sigma:.1e}, intersection over union {overlap(shape, true):.4f}")
    pictures = [render(rectangle, camera, LAST_SIGMA) for rectangle in (true, first, shape)]
    save([picture[..., None].expand(-1, -1, 3) for picture in pictures], arguments.picture, scale=4, bottom_up=False)
    return overlap(shape, true)


def render(shape: Tensor, camera: Camera, sigma: float) -> Tensor:
    """Render the soft silhouette (H, W) of the rectangle. ``shape`` (4,) is x, y, half width, half height."""
    x, y, half_width, half_height = shape.unbind()
    corners = [(x + i * half_width, y + j * half_height) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    xyz = torch.stack([torch.stack([u, torch.zeros_like(u), v]) for u, v in corners])
    tri = torch.tensor([[0, 1, 2], [0, 2, 3]], dtype=torch.int32)
    return rasterize_soft(xyz, tri, torch.ones(2, 1), camera, sigma=sigma)[1]


def front_camera(size: int) -> Camera:
    """Return a camera at (0, -3, 0) whose image covers x and z from -1 to 1 in the plane y = 0."""
    K = np.array([[1.5 * size, 0, size / 2], [0, 1.5 * size, size / 2], [0, 0, 1]])
    return look_at(np.array([0.0, -3, 0]), np.zeros(3), np.array([0.0, 0, 1]), K, width=size, height=size)


def overlap(shape: Tensor, true: Tensor) -> float:
    """Return the intersection over union of two rectangles, given as centre and half size (4,)."""
    low = torch.maximum(shape[:2] - shape[2:], true[:2] - true[2:])
    high = torch.minimum(shape[:2] + shape[2:], true[:2] + true[2:])
    common = (high - low).clamp_min(0).prod()
    union = 4 * shape[2:].abs().prod() + 4 * true[2:].prod() - common
    return float((common / union).detach())


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
