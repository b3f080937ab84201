"""Random textures and positions for the tests of texture lookups."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from fourd.rendering.triangles import texture

FILTERS = ("nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear")
BOUNDARIES = ("wrap", "clamp", "zero", "cube")


@dataclass(frozen=True)
class Lookup:
    """The tensors of a lookup, in the order of the arguments of ``texture``."""

    tex: Tensor
    uv: Tensor
    uv_da: Tensor
    bias: Tensor

    @property
    def tensors(self) -> list[Tensor]:
        return [self.tex, self.uv, self.uv_da, self.bias]


def random_lookup(
    rng: np.random.Generator,
    boundary_mode: str,
    channels: int = 3,
    *,
    items: int = 2,
    picture: tuple[int, int] = (30, 40),
    size: tuple[int, int] = (8, 16),
) -> Lookup:
    """Make random inputs of texture lookups for two pictures. The positions are inside and outside the texture, and the
    mip levels range from below 0 to above the last level.
    """
    is_cube = boundary_mode == "cube"
    coordinates = 3 if is_cube else 2
    shape = (items, 6, 8, 8, channels) if is_cube else (items, *size, channels)
    return Lookup(
        tensor(rng.standard_normal(shape)),
        tensor(rng.uniform(-1.5, 1.5, (2, *picture, coordinates))),
        tensor(rng.standard_normal((2, *picture, 2 * coordinates)) * 0.2),
        tensor(rng.standard_normal((2, *picture))),
    )


def smooth_lookup(rng: np.random.Generator, boundary_mode: str, filter_mode: str, pixels: int = 40) -> Lookup:
    """Make the inputs of texture lookups for one row of pixels. Small changes of these inputs do not change which
    texels and levels a lookup reads.
    """
    is_cube = boundary_mode == "cube"
    coordinates = 3 if is_cube else 2
    size = np.array([8, 8] if is_cube else [16, 8])  # width, height
    shape = (1, 6, 8, 8, 2) if is_cube else (1, 8, 16, 2)
    tex = rng.standard_normal(shape)
    cells = rng.integers(-3 * size, 3 * size, (pixels, 2)) if not is_cube else rng.integers(0, size, (pixels, 2))
    # Along an axis, a texel of level 2 covers four texels of level 0. The random offsets keep the positions away from
    # the texel centres of levels 0, 1 and 2.
    offset = 1 + rng.choice([-1, 1], (pixels, 2)) * rng.uniform(0.1, 0.4, (pixels, 2))
    st = (cells // 4 * 4 + offset) / size
    uv = _directions(rng, 2 * st - 1) if is_cube else st
    level = rng.uniform(0.1, 0.4, pixels) + (rng.integers(0, 2, pixels) if "linear-mipmap" in filter_mode else 0)
    angle, squeeze = rng.uniform(0, 6.3, pixels), rng.uniform(0.2, 0.8, pixels)
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], -1).reshape(pixels, 2, 2)
    footprint = turn @ (np.stack([np.ones(pixels), squeeze], -1)[:, :, None] * np.swapaxes(turn[::-1], 1, 2))
    footprint *= 2.0 ** (level - 0.2)[:, None, None] / size[:, None]
    if is_cube:
        footprint = _lift(uv, 2 * footprint)
    return Lookup(
        torch.from_numpy(tex),
        torch.from_numpy(uv.reshape(1, 1, pixels, coordinates)),
        torch.from_numpy(footprint.reshape(1, 1, pixels, 2 * coordinates)),
        torch.full((1, 1, pixels), 0.2, dtype=torch.float64),
    )


def _directions(rng: np.random.Generator, ab: np.ndarray) -> np.ndarray:
    """Convert positions on a face to directions of random length, on random faces."""
    axis, sign = rng.integers(0, 3, len(ab)), rng.choice([-1.0, 1.0], len(ab))
    out = np.empty((len(ab), 3))
    for row, (where, toward) in enumerate(zip(axis, sign, strict=True)):
        out[row] = np.insert(ab[row], where, toward)
    return out * rng.uniform(0.5, 2, (len(ab), 1))


def _lift(direction: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Convert derivatives (N, 2, 2) of positions on a face to derivatives (N, 3, 2) of the given directions."""
    out = np.zeros((len(direction), 3, 2))
    for row, one in enumerate(direction):
        axis = int(np.argmax(np.abs(one)))
        out[row, [k for k in range(3) if k != axis]] = footprint[row] * abs(one[axis])
    return out


def values_and_gradients(
    lookup: Lookup, upstream: Tensor, filter_mode: str, boundary_mode: str, **settings: object
) -> list[Tensor]:
    """Return the picture and the gradients of all inputs. If an input has no gradient, its gradient is filled with
    zeros."""
    leaves = [one.clone().requires_grad_() for one in lookup.tensors]
    out = texture(*leaves, None, filter_mode, boundary_mode, **settings)  # type: ignore[arg-type]
    found = torch.autograd.grad(out, leaves, upstream.to(out), allow_unused=True)
    gradients = [torch.zeros_like(leaf) if one is None else one for one, leaf in zip(found, leaves, strict=True)]
    return [out.detach(), *gradients]


def tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.asarray(values, dtype=np.float32))
