"""Estimate camera poses and textured spheres together, only from images.

    python examples/triangles/bundle_adjustment.py

The poses of all cameras, and the centres, radii and textures of the spheres are unknown. The poses, centres and radii
start with errors, and the textures start grey. Adam minimises the difference between the rendered and the given images
at several scales. The first steps compare only coarse scales, because the difference of sharp images has many local
minima. When the optimiser changes the rotation of a camera, the camera turns around the centre of the scene, not around
its own centre, so rotation and translation can be corrected independently.

The images determine the poses only up to one common rotation, translation and scale. The program removes the common
rotation before it computes the rotation errors, and the common similarity transformation before it computes the errors
of the centres.

The spheres have few triangles on purpose, because antialiasing finds a silhouette only at pixels that show a triangle
with a silhouette edge. On a finely tessellated sphere, the triangles at the silhouette are thinner than a pixel, so few
pixels show such a triangle and most of the gradient would be missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from common import perspective, save, uv_sphere
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import avg_pool2d
from torch.nn.functional import interpolate as resize

from fourd.rendering.triangles import antialias, interpolate, rasterize, texture

COARSEST = 4
"""The coarsest scale of the comparison averages 2^4 x 2^4 pixels."""

GRADIENT_BOOST = 3.0
"""Antialiasing finds about a third of the silhouettes of these spheres, so its gradients are multiplied by 3."""


@dataclass(frozen=True)
class Arguments:
    """Options of the adjustment."""

    cameras: int = 8
    """Number of cameras on a ring around the scene."""
    spheres: int = 8
    """Number of spheres."""
    error_deg: float = 4.0
    """Standard deviation of the rotation error of a camera about each axis, in degrees."""
    size: int = 128
    """Width and height of the images in pixels, a multiple of 16."""
    steps: int = 400
    """Steps of Adam."""
    seed: int = 0
    """Seed of the scene and of the errors."""
    picture: Path = Path("bundle_adjustment.png")
    """Output image: the given image of a camera, its first rendering and its last rendering."""


@dataclass(frozen=True)
class Scene:
    """Cameras and spheres.

    Attributes:
        R_camera_world: (C, 3, 3) rotations of the cameras.
        translation: (C, 3) translations of the transforms from world to camera coordinates.
        centre: (N, 3) centres of the spheres.
        radius: (N,) radii of the spheres.
        texture: (N, H, W, 3) textures of the spheres.
    """

    R_camera_world: Tensor
    translation: Tensor
    centre: Tensor
    radius: Tensor
    texture: Tensor


def main(arguments: Arguments) -> tuple[float, float]:
    """Adjust the scene. Returns the mean rotation error of the cameras before and after the adjustment, in degrees."""
    rng = np.random.default_rng(arguments.seed)
    true = random_scene(arguments.cameras, arguments.spheres, rng)
    first = disturb(true, arguments.error_deg, rng)
    renderer = Renderer(arguments.spheres, arguments.size)
    with torch.no_grad():
        targets = renderer.render(true)
    last = adjust(targets, first, renderer, arguments)
    before, after = rotation_error_deg(first, true), rotation_error_deg(last, true)
    print(f"mean rotation error of the cameras: {before:.3f} degrees before, {after:.3f} degrees after")
    print(f"mean error of the centres: {centre_error(first, true):.4f} before, {centre_error(last, true):.4f} after")
    with torch.no_grad():
        save([targets[0], renderer.render(first)[0], renderer.render(last)[0]], arguments.picture, scale=2)
    return before, after


def adjust(targets: Tensor, first: Scene, renderer: Renderer, arguments: Arguments) -> Scene:
    """Minimise the difference between the renderings and ``targets`` (C, H, W, 3)."""
    turn = torch.zeros_like(first.translation).requires_grad_()
    translation, centre = first.translation.clone().requires_grad_(), first.centre.clone().requires_grad_()
    log_radius, texels = first.radius.log().requires_grad_(), first.texture.clone().requires_grad_()
    rates = [(turn, 5e-3), (translation, 5e-3), (centre, 5e-3), (log_radius, 5e-3), (texels, 3e-2)]
    optimizer = torch.optim.Adam([{"params": [value], "lr": rate} for value, rate in rates], betas=(0.9, 0.99))
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: 0.02 ** (step / arguments.steps))
    for step in range(arguments.steps):
        # The comparison starts with the coarsest scale only. During the first two thirds of the steps, the finer scales
        # are added one by one, down to single pixels.
        finest = max(0, round(COARSEST * (1 - 1.5 * step / arguments.steps)))
        scene = Scene(rotation_matrix(turn) @ first.R_camera_world, translation, centre, log_radius.exp(), texels)
        difference = (renderer.render(scene) - targets).permute(0, 3, 1, 2)
        loss = sum(avg_pool2d(difference, 2**scale).square().mean() for scale in range(finest, COARSEST + 1))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % max(arguments.steps // 8, 1) == 0 or step == arguments.steps - 1:
            error = float(difference.detach().square().mean())
            print(f"step {step}: mean squared difference {error:.6f}, finest scale {2**finest} pixels")
    R = rotation_matrix(turn.detach()) @ first.R_camera_world
    return Scene(R, translation.detach(), centre.detach(), log_radius.detach().exp(), texels.detach())


class Renderer:
    """Renders spheres from cameras that look along the -z axis of their coordinate frame."""

    def __init__(self, spheres: int, size: int) -> None:
        self.unit, uv, tri = uv_sphere(6, 12)
        self.tri = torch.cat([tri + number * len(self.unit) for number in range(spheres)])
        # The textures are stacked vertically in one image.
        v = (torch.arange(spheres)[:, None] + 0.01 + 0.98 * uv[None, :, 1]) / spheres
        self.uv = torch.stack([uv[None, :, 0].expand_as(v), v], dim=-1).reshape(-1, 2)
        self.projection, self.size = perspective(0.36, near=0.5), size

    def render(self, scene: Scene) -> Tensor:
        """Render images (C, size, size, 3) with a black background."""
        xyz_world = (scene.centre[:, None] + scene.radius[:, None, None] * self.unit).reshape(-1, 3)
        xyz_camera = xyz_world @ scene.R_camera_world.transpose(-1, -2) + scene.translation[:, None]
        pos = torch.cat([xyz_camera, torch.ones_like(xyz_camera[..., :1])], dim=-1) @ self.projection.T
        rast, rast_db = rasterize(pos, self.tri, (self.size, self.size))
        uv, uv_da = interpolate(self.uv, rast, self.tri, rast_db=rast_db, diff_attrs="all")
        texels = scene.texture.flatten(0, 1)[None]
        colour = texture(texels, uv, uv_da, filter_mode="linear-mipmap-linear", max_mip_level=3)
        colour = torch.where(rast[..., 3:] > 0, colour, torch.zeros_like(colour))
        return antialias(colour, rast, pos, self.tri, pos_gradient_boost=GRADIENT_BOOST)


def random_scene(cameras: int, spheres: int, rng: np.random.Generator) -> Scene:
    """Return a scene of disjoint spheres with random textures, and of cameras that look at the origin from a ring of
    radius 5."""
    angles = np.linspace(0, 2 * np.pi, cameras, endpoint=False)
    R = Rotation.from_euler("x", 0.35 + 0.25 * np.cos(2 * angles)[:, None]) * Rotation.from_euler("y", angles[:, None])
    centres: list[NDArray[np.float64]] = []
    radii: list[float] = []
    while len(centres) < spheres:
        centre, radius = rng.uniform([-1.2, -1, -1.2], [1.2, 1, 1.2]), rng.uniform(0.3, 0.5)
        if all(np.linalg.norm(centre - c) > radius + r for c, r in zip(centres, radii, strict=True)):
            centres.append(centre)
            radii.append(radius)
    coarse = torch.from_numpy(rng.uniform(0, 1, (spheres, 3, 8, 16))).float()
    texels = resize(coarse, size=(32, 64), mode="bicubic").clamp(0, 1).permute(0, 2, 3, 1).contiguous()
    matrices = torch.from_numpy(R.as_matrix()).float()
    translation = torch.tensor([0.0, 0.0, -5.0]).repeat(cameras, 1)
    return Scene(matrices, translation, torch.tensor(np.array(centres)).float(), torch.tensor(radii), texels)


def disturb(true: Scene, error_deg: float, rng: np.random.Generator) -> Scene:
    """Return the scene with random errors and grey textures."""

    def noise(like: Tensor) -> Tensor:
        return torch.from_numpy(rng.normal(size=like.shape)).float()

    R = rotation_matrix(np.deg2rad(error_deg) * noise(true.translation)) @ true.R_camera_world
    radius = true.radius * torch.from_numpy(rng.uniform(0.8, 1.25, len(true.radius))).float()
    grey = torch.full_like(true.texture, 0.5)
    return Scene(
        R, true.translation + 0.05 * noise(true.translation), true.centre + 0.1 * noise(true.centre), radius, grey
    )


def rotation_matrix(turn: Tensor) -> Tensor:
    """Return the matrices (C, 3, 3) of rotation vectors (C, 3) in radians. The result is differentiable, also at 0."""
    x, y, z = turn.unbind(dim=1)
    zero = torch.zeros_like(x)
    return torch.linalg.matrix_exp(torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).reshape(-1, 3, 3))


def rotation_error_deg(scene: Scene, true: Scene) -> float:
    """Return the mean rotation error of the cameras in degrees, after alignment by one common rotation."""
    relative = Rotation.from_matrix((true.R_camera_world.transpose(-1, -2) @ scene.R_camera_world).double().numpy())
    return float(np.rad2deg((relative * relative.mean().inv()).magnitude()).mean())


def centre_error(scene: Scene, true: Scene) -> float:
    """Return the mean distance of the centres from the true centres, after alignment by a similarity transformation."""
    centred, true_centred = (s.centre.numpy() - s.centre.numpy().mean(axis=0) for s in (scene, true))
    R, _ = Rotation.align_vectors(true_centred, centred)
    aligned = R.apply(centred)
    scale = (aligned * true_centred).sum() / np.square(aligned).sum()
    return float(np.linalg.norm(scale * aligned - true_centred, axis=1).mean())


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
