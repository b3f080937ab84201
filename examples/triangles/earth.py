"""Learn the texture of a globe from small images, with and without mipmaps.

    python examples/triangles/earth.py

The target images are rendered from the true texture with 4 x 4 samples per pixel. Where the globe is far away or seen
at a grazing angle, a pixel covers many texels, but a bilinear lookup reads at most four of them. A mipmap lookup
averages all of them, so the learnt texture has less noise. The program prints the PSNR of both learnt textures.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro
from common import perspective, psnr, random_rotations, rigid, save, to_clip, uv_sphere
from torch import Tensor
from torch.nn.functional import avg_pool2d

from fourd.rendering.triangles import interpolate, rasterize, texture

Filter = Literal["linear", "linear-mipmap-linear"]


@dataclass(frozen=True)
class Arguments:
    """Options of the fit."""

    texture_size: int = 256
    """Height of the texture, in texels, a power of two. The width is twice the height."""
    size: int = 128
    """Width and height of the images, in pixels."""
    steps: int = 600
    """Steps of Adam per texture."""
    seed: int = 0
    """Seed of the true texture and of the poses."""
    picture: Path = Path("earth.png")
    """Output image: the upper left quarter of the true texture, and of the textures learnt with and without mipmaps."""


def main(arguments: Arguments) -> tuple[float, float]:
    """Learn one texture with mipmaps and one without. Returns the PSNR of both textures in dB, in this order."""
    true_texture = continents(arguments.texture_size, np.random.default_rng(arguments.seed))
    learnt = {mode: learn(true_texture, mode, arguments) for mode in ("linear-mipmap-linear", "linear")}
    scores = {mode: psnr(texels, true_texture) for mode, texels in learnt.items()}
    for mode, score in scores.items():
        print(f"{mode}: PSNR of the texture {score:.2f} dB")
    quarter = np.s_[: arguments.texture_size // 2, : arguments.texture_size]
    save([texels[quarter] for texels in (true_texture, *learnt.values())], arguments.picture, bottom_up=False)
    return scores["linear-mipmap-linear"], scores["linear"]


def learn(true_texture: Tensor, mode: Filter, arguments: Arguments) -> Tensor:
    """Learn a texture (H, W, 3) that reproduces images of the true texture."""
    globe = Globe()
    rng = np.random.default_rng(arguments.seed + 1)
    texels = torch.full_like(true_texture, 0.5).requires_grad_()
    optimizer = torch.optim.Adam([texels], lr=3e-2)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: 0.05 ** (step / arguments.steps))
    for step in range(arguments.steps):
        distance = float(rng.uniform(1.6, 8))
        matrix = perspective(0.4, near=0.1) @ rigid(random_rotations(1, rng), (0, 0, -distance))
        with torch.no_grad():
            fine = globe.render(matrix, true_texture, 4 * arguments.size, "linear-mipmap-linear")
            target = avg_pool2d(fine.permute(0, 3, 1, 2), 4).permute(0, 2, 3, 1)
        loss = (globe.render(matrix, texels, arguments.size, mode) - target).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % max(arguments.steps // 5, 1) == 0 or step == arguments.steps - 1:
            print(f"{mode}: step {step}, PSNR of the texture {psnr(texels.detach(), true_texture):.2f} dB")
    return texels.detach()


class Globe:
    """A unit sphere with texture coordinates."""

    def __init__(self) -> None:
        self.xyz, self.uv, self.tri = uv_sphere(48, 96)

    def render(self, matrix: Tensor, texels: Tensor, size: int, mode: Filter) -> Tensor:
        """Render images (B, size, size, 3) of the globe with the texture ``texels`` (H, W, 3), on a black background.
        ``matrix`` (B, 4, 4) transforms to clip space."""
        rast, rast_db = rasterize(to_clip(matrix, self.xyz), self.tri, (size, size))
        uv, uv_da = interpolate(self.uv, rast, self.tri, rast_db=rast_db, diff_attrs="all")
        derivatives = uv_da if mode == "linear-mipmap-linear" else None
        colour = texture(texels[None], uv, derivatives, filter_mode=mode, boundary_mode="wrap")
        return torch.where(rast[..., 3:] > 0, colour, torch.zeros_like(colour))


def continents(height: int, rng: np.random.Generator) -> Tensor:
    """Return a random map of land and sea, (height, 2 * height, 3) in [0, 1]. The left and right borders match."""
    frequency = np.hypot(np.fft.fftfreq(height)[:, None] * height, np.fft.fftfreq(2 * height)[None] * 2 * height)
    amplitude = np.where(frequency > 0, np.maximum(frequency, 1) ** -1.7, 0)
    noise = np.fft.fft2(rng.normal(size=(height, 2 * height)))
    elevation = np.fft.ifft2(noise * amplitude).real
    elevation = (elevation - np.quantile(elevation, 0.6)) / elevation.std()
    latitude = np.abs(np.linspace(-1, 1, height))[:, None] + 0.05 * elevation
    stops = np.array([-2.5, -0.02, 0.0, 0.25, 0.8, 1.6])
    colours = np.array([[10, 30, 90], [50, 110, 170], [210, 200, 140], [60, 130, 60], [120, 100, 70], [240, 240, 240]])
    image = np.stack([np.interp(elevation, stops, colours[:, channel]) for channel in range(3)], axis=-1)
    image[latitude > 0.88] = 245
    return torch.from_numpy(image / 255).float()


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
