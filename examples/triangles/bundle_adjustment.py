"""Adjust the poses of cameras together with the spheres that they see, from the images alone.

    python examples/triangles/bundle_adjustment.py

The scene is a group of textured spheres. Centres, radii and textures of the spheres are unknown, and the camera poses
are a few degrees off. Adam minimises the difference between the rendered and the given images. The images are blurred
at first, because the difference of sharp images has local minima. Camera 0 stays fixed. The program prints the mean
rotation error of the other cameras relative to camera 0, which does not depend on the scale of the scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from common import angle_deg, perspective, rotation_of_quaternion, save, uv_sphere
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import avg_pool2d

from fourd.raster.triangles import antialias, interpolate, rasterize, texture


@dataclass(frozen=True)
class Arguments:
    """Options of the adjustment."""

    cameras: int = 8
    """Number of cameras on a ring around the scene."""
    spheres: int = 5
    """Number of spheres."""
    error_deg: float = 4.0
    """Standard deviation of the rotation error of a camera about each axis, in degrees."""
    size: int = 96
    """Width and height of the images, in pixels."""
    steps: int = 600
    """Steps of Adam."""
    seed: int = 0
    """Seed of the scene and of the errors."""
    out: Path = Path("bundle_adjustment.png")
    """Output image: camera 1's image, its first rendering and its last rendering."""


@dataclass(frozen=True)
class Spheres:
    """Centres (N, 3), radii (N,) and textures (N, H, W, 3) of spheres."""

    centre: Tensor
    radius: Tensor
    texture: Tensor


@dataclass(frozen=True)
class Poses:
    """Quaternions (C, 4), in the order w, x, y, z, and translations (C, 3) from world to camera coordinates."""

    quaternion: Tensor
    translation: Tensor

    @property
    def R_camera_world(self) -> Tensor:
        """Rotations (C, 3, 3)."""
        return rotation_of_quaternion(self.quaternion)


def main(arguments: Arguments) -> tuple[float, float]:
    """Adjust the cameras. Returns the mean rotation errors before and after, in degrees."""
    rng = np.random.default_rng(arguments.seed)
    true_poses, true_spheres = ring(arguments.cameras), random_spheres(arguments.spheres, rng)
    renderer = Renderer(arguments.spheres, arguments.size)
    with torch.no_grad():
        targets = renderer.render(true_poses, true_spheres)
    first_poses = disturb(true_poses, arguments.error_deg, rng)
    first_spheres = Spheres(
        true_spheres.centre + torch.from_numpy(rng.normal(0, 0.1, true_spheres.centre.shape)).float(),
        true_spheres.radius * torch.from_numpy(rng.uniform(0.8, 1.25, arguments.spheres)).float(),
        torch.full_like(true_spheres.texture, 0.5),
    )
    before = rotation_error_deg(first_poses, true_poses)
    poses, spheres = adjust(targets, first_poses, first_spheres, renderer, arguments)
    after = rotation_error_deg(poses, true_poses)
    print(f"mean rotation error: {before:.2f} degrees before, {after:.3f} degrees after")
    with torch.no_grad():
        pictures = [targets[1], renderer.render(first_poses, first_spheres)[1], renderer.render(poses, spheres)[1]]
    save(pictures, arguments.out, scale=2)
    return before, after


def adjust(
    targets: Tensor, poses: Poses, spheres: Spheres, renderer: Renderer, arguments: Arguments
) -> tuple[Poses, Spheres]:
    """Minimise the difference of the renderings from ``targets`` (C, H, W, 3)."""
    quaternion, translation = poses.quaternion.clone().requires_grad_(), poses.translation.clone().requires_grad_()
    centre, log_radius = spheres.centre.clone().requires_grad_(), spheres.radius.log().requires_grad_()
    texels = spheres.texture.clone().requires_grad_()
    rates = [(quaternion, 3e-3), (translation, 5e-3), (centre, 5e-3), (log_radius, 5e-3), (texels, 3e-2)]
    optimizer = torch.optim.Adam([{"params": [value], "lr": rate} for value, rate in rates])
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: 0.02 ** (step / arguments.steps))
    for step in range(arguments.steps):
        images = renderer.render(Poses(quaternion, translation), Spheres(centre, log_radius.exp(), texels))
        window = 2 * int(8 * max(0.0, 0.6 - step / arguments.steps)) + 1
        loss = (blur(images, window) - blur(targets, window)).square().mean()
        optimizer.zero_grad()
        loss.backward()
        for gradient in (quaternion.grad, translation.grad):
            assert gradient is not None
            gradient[0] = 0
        optimizer.step()
        schedule.step()
        if step % max(arguments.steps // 6, 1) == 0 or step == arguments.steps - 1:
            print(f"step {step}: mean squared difference {float(loss):.6f} after a blur of {window} pixels")
    return Poses(quaternion.detach(), translation.detach()), Spheres(
        centre.detach(), log_radius.detach().exp(), texels.detach()
    )


class Renderer:
    """Renders spheres from cameras that look along -z of their own frame."""

    def __init__(self, spheres: int, size: int) -> None:
        self.unit, uv, tri = uv_sphere(16, 32)
        count = self.unit.shape[0]
        self.tri = torch.cat([tri + number * count for number in range(spheres)])
        # The textures are stacked in one image, one above the other.
        v = (torch.arange(spheres)[:, None] + uv[None, :, 1] * 0.98 + 0.01) / spheres
        self.uv = torch.stack([uv[None, :, 0].expand_as(v), v], dim=-1).reshape(-1, 2).contiguous()
        self.projection, self.size = perspective(0.45, near=0.5), size

    def render(self, poses: Poses, spheres: Spheres) -> Tensor:
        """Render images (C, size, size, 3) on black."""
        xyz_world = (spheres.centre[:, None] + spheres.radius[:, None, None] * self.unit).reshape(-1, 3)
        xyz_camera = xyz_world @ poses.R_camera_world.transpose(-1, -2) + poses.translation[:, None]
        homogeneous = torch.cat([xyz_camera, torch.ones_like(xyz_camera[..., :1])], dim=-1)
        pos = homogeneous @ self.projection.T
        rast, rast_db = rasterize(pos, self.tri, (self.size, self.size))
        uv, uv_da = interpolate(self.uv, rast, self.tri, rast_db=rast_db, diff_attrs="all")
        texels = spheres.texture.flatten(0, 1)[None]
        colour = texture(texels, uv, uv_da, filter_mode="linear-mipmap-linear", max_mip_level=3)
        colour = torch.where(rast[..., 3:] > 0, colour, torch.zeros_like(colour))
        return antialias(colour, rast, pos, self.tri)


def ring(count: int) -> Poses:
    """Return cameras on a ring of radius 5 that look at the origin."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rotations = Rotation.from_euler("x", 0.35)
    turns = Rotation.from_euler("y", angles[:, None])
    quaternion = (rotations * turns).as_quat(scalar_first=True)
    return Poses(torch.from_numpy(quaternion).float(), torch.tensor([0.0, 0.0, -5.0]).repeat(count, 1))


def random_spheres(count: int, rng: np.random.Generator) -> Spheres:
    """Return spheres with random smooth textures around the origin."""
    coarse = torch.from_numpy(rng.uniform(0, 1, (count, 3, 8, 16))).float()
    texels = torch.nn.functional.interpolate(coarse, size=(32, 64), mode="bicubic").clamp(0, 1)
    return Spheres(
        torch.from_numpy(rng.uniform(-1, 1, (count, 3))).float(),
        torch.from_numpy(rng.uniform(0.35, 0.6, count)).float(),
        texels.permute(0, 2, 3, 1).contiguous(),
    )


def disturb(poses: Poses, error_deg: float, rng: np.random.Generator) -> Poses:
    """Return the poses with random errors. Camera 0 keeps its pose."""
    count = poses.quaternion.shape[0]
    noise = np.deg2rad(error_deg) * rng.normal(size=(count, 3))
    shift = 0.05 * rng.normal(size=(count, 3))
    noise[0] = shift[0] = 0
    R = Rotation.from_rotvec(noise) * Rotation.from_quat(poses.quaternion.numpy(), scalar_first=True)
    quaternion = torch.from_numpy(R.as_quat(scalar_first=True)).float()
    return Poses(quaternion, poses.translation + torch.from_numpy(shift).float())


def rotation_error_deg(poses: Poses, true: Poses) -> float:
    """Return the mean rotation error of the cameras relative to camera 0, in degrees."""
    relative = poses.R_camera_world[1:] @ poses.R_camera_world[0].T
    true_relative = true.R_camera_world[1:] @ true.R_camera_world[0].T
    return float(angle_deg(relative, true_relative).mean())


def blur(images: Tensor, window: int) -> Tensor:
    """Return images (B, H, W, 3) averaged over ``window`` x ``window`` pixels; ``window`` is odd."""
    channels_first = images.permute(0, 3, 1, 2)
    return avg_pool2d(channels_first, window, stride=1, padding=window // 2)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
