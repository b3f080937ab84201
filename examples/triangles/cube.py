"""Recover the corners and colours of a cube from tiny images.

    python examples/triangles/cube.py --size 4

Each step renders two cubes in the same random pose: the true cube, and the cube whose corners and colours are
optimised. Antialiasing is the only source of gradients with respect to the positions of silhouettes. A small final
error of the corners therefore shows that these gradients are right, even for an image of only 4 x 4 pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from common import cube, face_colours, perspective, random_rotations, rigid, save, to_clip
from torch import Tensor

from fourd.rendering.triangles import antialias, antialias_construct_topology, interpolate, rasterize


@dataclass(frozen=True)
class Arguments:
    """Options of the fit."""

    size: int = 8
    """Width and height, in pixels, of the images that are used for the fit."""
    steps: int = 8000
    """Steps of Adam."""
    batch: int = 4
    """Images per step."""
    seed: int = 0
    """Seed of the poses and of the first cube."""
    picture: Path = Path("cube.png")
    """Output image: the true cube, the first cube and the fitted cube, in one pose."""


def main(arguments: Arguments) -> float:
    """Fit the cube. Returns the final mean distance of the corners from the true corners, as a fraction of the edge
    length."""
    rng = np.random.default_rng(arguments.seed)
    true_xyz, tri = cube()
    true_colours, colour_tri = face_colours()
    scene = Scene(tri, colour_tri)
    first_xyz = true_xyz + torch.from_numpy(rng.uniform(-0.5, 0.5, true_xyz.shape)).float()
    first_colours = torch.from_numpy(rng.uniform(0, 1, true_colours.shape)).float()
    xyz, colours = first_xyz.clone().requires_grad_(), first_colours.clone().requires_grad_()
    optimizer = torch.optim.Adam([xyz, colours], lr=1e-2)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: 0.01 ** (step / arguments.steps))
    error = float("nan")
    for step in range(arguments.steps):
        matrix = poses(arguments.batch, rng)
        target = scene.render(matrix, true_xyz, true_colours, arguments.size)
        loss = (scene.render(matrix, xyz, colours, arguments.size) - target).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        error = float((xyz.detach() - true_xyz).norm(dim=1).mean()) / 2
        if step % max(arguments.steps // 10, 1) == 0 or step == arguments.steps - 1:
            print(f"step {step}: mean corner error {error:.5f} of the edge")
    matrix = poses(1, np.random.default_rng(arguments.seed))
    pairs = [(true_xyz, true_colours), (first_xyz, first_colours), (xyz, colours)]
    save([scene.render(matrix, *pair, 256)[0] for pair in pairs], arguments.picture)
    return error


def poses(count: int, rng: np.random.Generator) -> Tensor:
    """Return random poses of the cube in front of the camera, as matrices (count, 4, 4) to clip space."""
    return perspective(0.4) @ rigid(random_rotations(count, rng), (0, 0, -5.5))


class Scene:
    """The triangles of a cube with one colour per face."""

    def __init__(self, tri: Tensor, colour_tri: Tensor) -> None:
        self.tri, self.colour_tri = tri, colour_tri
        self.topology = antialias_construct_topology(tri)

    def render(self, matrix: Tensor, xyz: Tensor, colours: Tensor, size: int) -> Tensor:
        """Render antialiased images (B, size, size, 3) with a black background."""
        pos = to_clip(matrix, xyz)
        rast, _ = rasterize(pos, self.tri, (size, size))
        colour, _ = interpolate(colours, rast, self.colour_tri)
        colour = torch.where(rast[..., 3:] > 0, colour, torch.zeros_like(colour))
        return antialias(colour, rast, pos, self.tri, topology=self.topology)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
