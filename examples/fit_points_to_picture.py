"""Fit coloured points to an image with the differentiable point renderer and Adam.

    python examples/fit_points_to_picture.py picture.jpg --out fitted.png

Without an image, the program fits a synthetic colour gradient with a disc.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from PIL import Image
from torch import Tensor

from fourd import Camera, look_at, render_points


@dataclass(frozen=True)
class Arguments:
    """Options of the fit."""

    picture: tyro.conf.Positional[Path | None] = None
    """The image to fit, JPEG or PNG."""
    out: Path = Path("fitted.png")
    """Output image: the target on the left, the rendered points on the right."""
    size: int = 128
    """Width and height of the square image, in pixels."""
    points: int = 4000
    """Number of points."""
    steps: int = 100
    """Steps of Adam."""
    layers: int = 15
    """K, the maximum number of points composited per pixel."""


def main(arguments: Arguments) -> float:
    """Fit the points and write the result. Returns the final PSNR in dB."""
    torch.manual_seed(0)
    target = load_target(arguments.picture, arguments.size)
    camera = front_camera(arguments.size)
    parameters = initial_points(arguments.points)
    optimizer = torch.optim.Adam(
        [
            {"params": [parameters["xyz"]], "lr": 2e-3},
            {"params": [parameters["rgb"], parameters["log_radius"], parameters["density"]], "lr": 3e-2},
        ]
    )
    for step in range(arguments.steps):
        image = render(parameters, camera, arguments.layers)
        loss = (image - target).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step % 20 == 0 or step == arguments.steps - 1:
            print(f"step {step}: {psnr(loss):.2f} dB")
    with torch.no_grad():
        image = render(parameters, camera, arguments.layers)
    save(torch.cat([target, image], dim=1), arguments.out)
    print(f"wrote {arguments.out}: target on the left, {arguments.points} points on the right")
    return psnr((image - target).square().mean())


def front_camera(size: int) -> Camera:
    """Return a camera at (0, -3, 0) whose image covers x and z from -1 to 1 in the plane y = 0."""
    focal_px = 1.5 * size
    K = np.array([[focal_px, 0, size / 2], [0, focal_px, size / 2], [0, 0, 1]])
    return look_at(np.array([0.0, -3, 0]), np.zeros(3), np.array([0.0, 0, 1]), K, width=size, height=size)


def initial_points(count: int) -> dict[str, Tensor]:
    """Return random grey points in a thin slab that faces the camera. All tensors are leaf tensors."""
    xyz = (torch.rand(count, 3) * 2 - 1) * torch.tensor([1.0, 0.1, 1.0])
    radius = 1.5 / count**0.5  # radius in world units, so large that neighbouring points overlap
    return {
        "xyz": xyz.requires_grad_(),
        "rgb": torch.zeros(count, 3).requires_grad_(),  # before the sigmoid
        "log_radius": torch.full((count,), radius).log().requires_grad_(),
        "density": torch.zeros(count).requires_grad_(),  # before the sigmoid
    }


def render(parameters: dict[str, Tensor], camera: Camera, layers: int) -> Tensor:
    """Render an image (H, W, 3) of the points on a black background."""
    return render_points(
        parameters["xyz"],
        parameters["rgb"].sigmoid(),
        parameters["log_radius"].exp(),
        parameters["density"].sigmoid(),
        camera,
        layers=layers,
    ).features


def load_target(path: Path | None, size: int) -> Tensor:
    """Load the image as (size, size, 3) in [0, 1]. If ``path`` is None, return a colour gradient with a disc."""
    if path is not None:
        with Image.open(path, formats=["JPEG", "PNG"]) as picture:
            pixels = np.asarray(picture.convert("RGB").resize((size, size), Image.Resampling.LANCZOS))
        return torch.from_numpy(pixels.copy()).float() / 255
    y, x = torch.meshgrid(torch.linspace(0, 1, size), torch.linspace(0, 1, size), indexing="ij")
    disc = ((x - 0.5) ** 2 + (y - 0.5) ** 2 < 0.09).float()
    return torch.stack([x, y, disc], dim=-1)


def psnr(mean_squared_error: Tensor) -> float:
    """Return the peak signal-to-noise ratio in dB, for pixel values in [0, 1]."""
    return float(-10 * torch.log10(mean_squared_error.detach()))


def save(image: Tensor, path: Path) -> None:
    """Write an image (H, W, 3) in [0, 1]."""
    Image.fromarray((image.clamp(0, 1) * 255).round().byte().numpy()).save(path)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
