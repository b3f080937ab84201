"""Benchmark computations: texture lookups."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from fourd.benchmarks.timing import Work
from fourd.rendering.triangles import texture

SEED = 5


def make_textured_plane(side: int) -> dict[str, Tensor]:
    """Make the arguments of ``texture`` for a plane that is seen obliquely and rotated by 0.4 radians.

    The arguments are a random, repeating texture ``tex`` (1, side, side, 3), and ``uv`` (1, side, side, 2) and
    ``uv_da`` (1, side, side, 4) of an image of side x side pixels. The longer axes of the pixels' footprints in the
    texture are 1 to 4.7 texels long.
    """
    generator = torch.Generator().manual_seed(SEED)
    places = torch.arange(side, dtype=torch.float64) + 0.5
    rows, columns = torch.meshgrid(places, places, indexing="ij")

    def position(x: Tensor, y: Tensor) -> Tensor:
        across, down = x / side - 0.5, y / side - 0.5
        depth = 1.2 + down
        cosine, sine = math.cos(0.4), math.sin(0.4)
        return (
            torch.stack([cosine * across + sine * down, cosine * down - sine * across], -1) * (1.7 / depth)[..., None]
        )

    by_x = position(columns + 0.5, rows) - position(columns - 0.5, rows)
    by_y = position(columns, rows + 0.5) - position(columns, rows - 0.5)
    return {
        "tex": torch.rand(1, side, side, 3, generator=generator),
        "uv": position(columns, rows)[None].float(),
        "uv_da": torch.stack([by_x, by_y], -1).flatten(-2)[None].float(),
    }


def trilinear_texture(side: int, backward: bool) -> Work:
    """Return a function that builds the mip levels of a texture and samples it. If ``backward`` is true, the function
    only runs the backward pass, which computes the gradients with respect to all arguments."""
    arguments = make_textured_plane(side)
    if not backward:
        return lambda: texture(**arguments)  # type: ignore[arg-type]
    leaves = [one.requires_grad_() for one in arguments.values()]
    total = texture(leaves[0], leaves[1], leaves[2])
    upstream = torch.randn(total.shape, generator=torch.Generator().manual_seed(SEED))
    return lambda: torch.autograd.grad(total, leaves, upstream, retain_graph=True)
