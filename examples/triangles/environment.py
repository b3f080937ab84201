"""Recover an environment map and a Phong highlight from images of a reflective torus.

    python examples/triangles/environment.py

The colour of a pixel is the environment map in the direction of the reflected ray, plus a Phong highlight of unknown
colour and exponent. The environment map is a cube map with seamless edges: near an edge, the gradient also reaches the
texels of the neighbouring face.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
import tyro
from common import face_colours, perspective, psnr, random_rotations, rigid, save, to_clip
from torch import Tensor
from torch.nn.functional import interpolate as resize
from torch.nn.functional import normalize

from fourd.rendering.triangles import interpolate, rasterize, texture

LIGHT = normalize(torch.tensor([1.0, 1.0, 2.0]), dim=0)
"""Direction towards the light, in camera coordinates."""


@dataclass(frozen=True)
class Arguments:
    """Options of the fit."""

    map_size: int = 32
    """Width and height of each face of the environment map, in texels, a power of two."""
    size: int = 128
    """Width and height of the images, in pixels."""
    steps: int = 600
    """Steps of Adam."""
    seed: int = 0
    """Seed of the poses."""
    picture: Path = Path("environment.png")
    """Output image: the torus with the true and with the recovered material, then the faces of the recovered
    environment map."""


@dataclass(frozen=True)
class Material:
    """The quantities that the program recovers.

    Attributes:
        map: (6, S, S, 3) environment map.
        highlight: (3,) colour of the Phong highlight.
        exponent: () Phong exponent.
    """

    map: Tensor
    highlight: Tensor
    exponent: Tensor


def main(arguments: Arguments) -> tuple[float, float]:
    """Recover the material. Returns the PSNR of the environment map in dB, and the recovered exponent."""
    rng = np.random.default_rng(arguments.seed)
    true = Material(sky(arguments.map_size), torch.tensor([0.8, 0.6, 0.4]), torch.tensor(25.0))
    torus = Torus()
    env = torch.full_like(true.map, 0.5).requires_grad_()
    highlight, log_exponent = torch.full((3,), 0.2).requires_grad_(), torch.tensor(1.0).requires_grad_()
    optimizer = torch.optim.Adam([{"params": [env], "lr": 3e-2}, {"params": [highlight, log_exponent], "lr": 6e-2}])
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: 0.05 ** (step / arguments.steps))
    for step in range(arguments.steps):
        R = random_rotations(1, rng)
        with torch.no_grad():
            target = torus.render(R, true, arguments.size)
        guess = Material(env, highlight, log_exponent.exp())
        loss = (torus.render(R, guess, arguments.size) - target).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % max(arguments.steps // 5, 1) == 0 or step == arguments.steps - 1:
            print(
                f"step {step}: PSNR of the map {psnr(env.detach(), true.map):.2f} dB, "
                f"exponent {float(log_exponent.detach().exp()):.2f} (true: 25)"
            )
    R = random_rotations(1, np.random.default_rng(arguments.seed))
    found = Material(env.detach(), highlight.detach(), log_exponent.detach().exp())
    rows = [torch.cat(list(found.map[first : first + 3]), dim=1) for first in (0, 3)]
    faces = interpolate_image(torch.cat(rows), (192, 288))
    save([*(torus.render(R, material, 192)[0] for material in (true, found)), faces], arguments.picture)
    return psnr(found.map, true.map), float(found.exponent)


class Torus:
    """A torus with normals, seen along -z."""

    def __init__(self) -> None:
        mesh = trimesh.creation.torus(major_radius=1.0, minor_radius=0.45, major_sections=96, minor_sections=48)
        self.xyz = torch.from_numpy(np.array(mesh.vertices)).float()
        self.normal = torch.from_numpy(np.array(mesh.vertex_normals)).float()
        self.tri = torch.from_numpy(np.array(mesh.faces)).int()

    def render(self, R: Tensor, material: Material, size: int) -> Tensor:
        """Render the torus with the rotations ``R`` (B, 3, 3), on a black background. Returns (B, size, size, 3)."""
        pose = rigid(R, (0, 0, -4.5))
        rast, _ = rasterize(to_clip(perspective(0.4) @ pose, self.xyz), self.tri, (size, size))
        xyz_camera = to_clip(pose, self.xyz)[..., :3].contiguous()
        normal_camera = self.normal @ R.transpose(-1, -2)
        attributes, _ = interpolate(torch.cat([xyz_camera, normal_camera], dim=-1), rast, self.tri)
        view, normal = normalize(attributes[..., :3], dim=-1), normalize(attributes[..., 3:], dim=-1)
        mirrored = view - 2 * (view * normal).sum(-1, keepdim=True) * normal
        mirrored_world = mirrored @ R[:, None]
        colour = texture(material.map[None], mirrored_world.contiguous(), filter_mode="linear", boundary_mode="cube")
        cosine = (mirrored @ LIGHT).clamp_min(1e-4)[..., None]
        colour = colour + material.highlight * cosine**material.exponent
        return torch.where(rast[..., 3:] > 0, colour, torch.zeros_like(colour))


def sky(size: int) -> Tensor:
    """Return a cube map (6, size, size, 3) with stripes. Each face has its own colour."""
    y, x = torch.meshgrid(torch.linspace(0, 1, size), torch.linspace(0, 1, size), indexing="ij")
    colours, _ = face_colours()
    faces = []
    for face in range(6):
        stripes = (torch.sin(2 * torch.pi * (x * (1 + face % 3) + y * (1 + face // 3))) > 0).float()
        faces.append(colours[face] * (0.4 + 0.3 * stripes + 0.3 * y)[..., None])
    return torch.stack(faces)


def interpolate_image(image: Tensor, size: tuple[int, int]) -> Tensor:
    """Return an image (H, W, 3), resized to ``size`` (height, width) by nearest-neighbour sampling."""
    return resize(image.permute(2, 0, 1)[None], size)[0].permute(1, 2, 0)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
