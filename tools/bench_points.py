"""Time the point compositor: medians in ms and as shares of a 2048^3 float32 matrix product in the same process."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
import tyro

from fourd.cameras import Camera, look_at
from fourd.raster import render_points


@dataclass(frozen=True)
class Arguments:
    """What to render."""

    points: int = 65536
    """Number of points."""
    size: int = 512
    """Width and height in pixels."""
    layers: int = 15
    """K."""
    repeats: int = 31
    """Runs of each; the median counts."""


def main(arguments: Arguments) -> None:
    """Print the table."""
    product = torch.randn(2048, 2048)
    unit = median(lambda: torch.mm(product, product), 7)
    print(f"{torch.get_num_threads()} threads; 2048^3 matrix product {unit:.1f} ms")
    print("| points | forward ms | forward + backward ms | of a product |")
    print("|---|---|---|---|")
    for name, arrays in (("figure", figure(arguments.points)), ("volume", volume(arguments.points))):
        camera = view(arguments.size)
        forward = median(lambda: run(arrays, camera, arguments.layers, False), arguments.repeats)  # noqa: B023
        both = median(lambda: run(arrays, camera, arguments.layers, True), arguments.repeats)  # noqa: B023
        print(f"| {name} | {forward:.1f} | {both:.1f} | {forward / unit:.2f}, {both / unit:.2f} |")


def run(arrays: list[torch.Tensor], camera: Camera, layers: int, backward: bool) -> None:
    """One picture, and one gradient of everything."""
    free = [array.detach().requires_grad_(backward) for array in arrays]
    out = render_points(free[0], free[1], free[2], free[3], camera, layers=layers)
    if backward:
        (out.features.sum() + out.alpha.sum()).backward()


def median(work: Callable[[], object], repeats: int) -> float:
    """Median time in ms, after two runs to warm up."""
    times = []
    for _ in range(repeats + 2):
        started = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - started))
    return statistics.median(times[2:])


def view(size: int) -> Camera:
    """A camera 3 units from the origin."""
    intrinsics = np.array([[1.3 * size, 0, size / 2], [0, 1.3 * size, size / 2], [0, 0, 1]])
    return look_at(np.array([0.0, -3, 0.4]), np.zeros(3), np.array([0.0, 0, 1]), intrinsics, size, size)


def figure(count: int) -> list[torch.Tensor]:
    """A closed surface that fills 40% of the picture: even points, radii of 1.3 spacings."""
    torch.manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(count, 3), dim=1)
    xyz = directions * torch.tensor([0.75, 0.75, 0.9])
    radius = torch.full((count,), 1.3 * (8.0 / count) ** 0.5)
    return [xyz, torch.rand(count, 3), radius, torch.full((count,), 0.95)]


def volume(count: int) -> list[torch.Tensor]:
    """Half-transparent points throughout a ball."""
    torch.manual_seed(0)
    xyz = torch.nn.functional.normalize(torch.randn(count, 3), dim=1) * torch.rand(count, 1) ** (1 / 3)
    return [xyz, torch.rand(count, 3), torch.full((count,), 0.015), torch.rand(count)]


if __name__ == "__main__":
    main(tyro.cli(Arguments))
