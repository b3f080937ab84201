"""Points of space encoded by a multi-resolution hash grid: ``torch.ops.fourd.encode_hash_grid``, its gradient, and the
same in plain torch.

The encoding is that of Instant-NGP (Mueller et al. 2022, Instant Neural Graphics Primitives with a Multiresolution Hash
Encoding, sec. 3), whose constants it takes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import torch
from torch import Tensor

from fourd.ops.gpu import cuda_unavailable_reason, dense, load_gpu, takes
from fourd.ops.loading import as_array, native, simd_name, thread_count

MOST_LEVELS = 32
MOST_FEATURES = 8
LOG2_ENTRIES = (4, 24)
ALIGN = 16  # rows
FINEST = 2**20  # cells a side; float32 still tells sixteen places apart within a cell
PRIMES = (1, 2654435761, 805459861)  # the paper's eq. 4


@dataclass(frozen=True)
class HashGridShape:
    """The sizes of a hash grid; the paper's names are in brackets.

    Raises:
        ValueError: naming the field, what was expected and what came.
    """

    levels: int = 16
    """Grids, from coarse to fine, 1 to 32 (L)."""
    features: int = 2
    """Numbers that a sample holds, 1 to 8 (F)."""
    log2_entries: int = 19
    """Logarithm of the most samples that a level keeps, 4 to 24 (T); levels that have more share theirs by a hash."""
    coarsest: int = 16
    """Cells a side of the first level (N_min)."""
    finest: int = 2048
    """Cells a side of the last level, up to 2^20 (N_max)."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("levels", 1, MOST_LEVELS),
            ("features", 1, MOST_FEATURES),
            ("log2_entries", *LOG2_ENTRIES),
            ("coarsest", 1, FINEST),
            ("finest", self.coarsest, FINEST),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name}: expected {low} to {high}, got {value}")

    @property
    def resolutions(self) -> tuple[int, ...]:
        """Cells a side, by level; evenly spaced in their logarithm. One level has the coarsest alone."""
        growth = math.log(self.finest / self.coarsest) / max(self.levels - 1, 1)
        # Rounding must not take the last level's side one below the finest.
        return tuple(int(self.coarsest * math.exp(growth * level) + 1e-6) for level in range(self.levels))

    @property
    def entries(self) -> tuple[int, ...]:
        """Samples that are kept, by level: all, or as many as a hash chooses between."""
        return tuple(min((side + 1) ** 3, 2**self.log2_entries) for side in self.resolutions)

    @property
    def offsets(self) -> tuple[int, ...]:
        """The row of the table that each level begins at: a multiple of 16, so that it begins a cache line."""
        ends = accumulate(self.entries, lambda end, entries: _aligned(end) + entries)
        return tuple(end - entries for end, entries in zip(ends, self.entries, strict=True))

    @property
    def total_entries(self) -> int:
        """Rows of the table: those of all levels, and the few between that nothing reads."""
        return self.offsets[-1] + self.entries[-1]

    @property
    def out_features(self) -> int:
        """Numbers that encode a point."""
        return self.levels * self.features


def _aligned(row: int) -> int:
    return (row + ALIGN - 1) // ALIGN * ALIGN


def encode(coordinates: Tensor, table: Tensor, shape: HashGridShape) -> Tensor:
    """Trilinear samples of every level, side by side (Mueller et al. 2022, sec. 3).

    A level whose samples all fit keeps them in rows x + y s + z s^2 (s = resolution + 1); of others, sample (x, y, z)
    is in row (x xor 2654435761 y xor 805459861 z) mod 2^log2_entries, in 32 bits.

    Args:
        coordinates: (N, 3) x, y, z in [0, 1]; what lies outside is clamped to the border, and what is no number counts
            as 0. Float32 on the CPU or, where its kernels are built, on a CUDA device; anything else is encoded by
            :func:`encode_reference`. The first and last samples of a level lie on the borders.
        table: (shape.total_entries, shape.features), of the coordinates' dtype and device.
        shape: the grid's sizes.

    Returns:
        (N, shape.out_features), level by level. Differentiable once in the table and in the coordinates (zero where
        these are clamped); what needs no gradient costs none. On the CPU the gradient is the same for any number of
        threads, which FOURD_THREADS sets (else torch.get_num_threads()); on a GPU its last bits differ from run to run.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    _check(coordinates, table, shape)
    device = coordinates.device.type
    kernels = device == "cpu" or (device == "cuda" and not cuda_unavailable_reason())
    if coordinates.dtype == torch.float64 or not kernels:
        return encode_reference(coordinates, table, shape)
    return _encode(coordinates, table, shape.resolutions, shape.log2_entries)


def encode_reference(coordinates: Tensor, table: Tensor, shape: HashGridShape) -> Tensor:
    """What :func:`encode` promises, in plain torch; any device, float32 or float64."""
    _check(coordinates, table, shape)
    places = coordinates.nan_to_num(nan=0.0).clamp(0, 1)
    levels = zip(shape.resolutions, shape.entries, shape.offsets, strict=True)
    return torch.cat([_level(places, table[offset : offset + count], side) for side, count, offset in levels], dim=1)


def _level(places: Tensor, values: Tensor, resolution: int) -> Tensor:
    """(N, F) samples of one level, whose entries are values."""
    scaled = places * resolution
    low = scaled.detach().long().clamp(max=resolution - 1)
    share = scaled - low
    found = []
    for corner in range(8):
        far = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2], device=places.device)
        weight = torch.where(far.bool(), share, 1 - share).prod(dim=1, keepdim=True)
        found.append(weight * values[_rows(low + far, resolution, len(values))])
    return torch.stack(found).sum(dim=0)


def _rows(sample: Tensor, resolution: int, entries: int) -> Tensor:
    """The entries of samples (N, 3) of a level that has so many."""
    x, y, z = sample.unbind(dim=1)
    side = resolution + 1
    if side**3 <= entries:
        return x + y * side + z * side**2
    # Entries are a power of two, so that bits above 32 of the products do not matter.
    return (x * PRIMES[0] ^ y * PRIMES[1] ^ z * PRIMES[2]) & (entries - 1)


def _check(coordinates: Tensor, table: Tensor, shape: HashGridShape) -> None:
    if coordinates.ndim != 2 or coordinates.shape[1] != 3:
        raise ValueError(f"coordinates: expected shape (N, 3), got {tuple(coordinates.shape)}")
    expected = (shape.total_entries, shape.features)
    if table.shape != expected:
        raise ValueError(f"table: expected shape {expected}, got {tuple(table.shape)}")
    if coordinates.dtype not in (torch.float32, torch.float64):
        raise TypeError(f"coordinates: expected float32 or float64, got {_name(coordinates.dtype)}")
    if table.dtype != coordinates.dtype:
        raise TypeError(f"table: expected {_name(coordinates.dtype)} as coordinates have, got {_name(table.dtype)}")
    if table.device != coordinates.device:
        raise ValueError(f"table: expected device {coordinates.device} as coordinates have, got {table.device}")


def _name(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")


@torch.library.custom_op("fourd::encode_hash_grid", mutates_args=(), device_types=("cpu", "cuda"))
def _encode(coordinates: Tensor, table: Tensor, resolutions: Sequence[int], log2_entries: int) -> Tensor:
    out = _empty_rows(coordinates, table, resolutions)
    if takes(coordinates):
        gpu = load_gpu(coordinates.device)
        grid = (dense(coordinates), dense(table), list(resolutions), log2_entries)
        with gpu.current():
            gpu.kernels.encode_hash_grid(*grid, gpu.stream, out)
        return out
    native().encode_hash_grid(
        as_array(coordinates),
        as_array(table),
        list(resolutions),
        log2_entries,
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        out.numpy(),
    )
    return out


@_encode.register_fake
def _(coordinates: Tensor, table: Tensor, resolutions: Sequence[int], log2_entries: int) -> Tensor:
    return _empty_rows(coordinates, table, resolutions)


@torch.library.custom_op("fourd::encode_hash_grid_backward", mutates_args=(), device_types=("cpu", "cuda"))
def _encode_backward(
    coordinates: Tensor,
    table: Tensor,
    resolutions: Sequence[int],
    log2_entries: int,
    gradient: Tensor,
    moves: bool,
    learns: bool,
) -> tuple[Tensor, Tensor]:
    grad_coordinates, grad_table = _empty_gradients(coordinates, table, moves, learns)
    if takes(coordinates):
        gpu = load_gpu(coordinates.device)
        grid = (dense(coordinates), dense(table), list(resolutions), log2_entries)
        targets = (grad_table if learns else None, grad_coordinates if moves else None)
        with gpu.current():
            gpu.kernels.encode_hash_grid_backward(*grid, gpu.stream, dense(gradient), *targets)
        return grad_coordinates, grad_table
    native().encode_hash_grid_backward(
        as_array(coordinates),
        as_array(table),
        list(resolutions),
        log2_entries,
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        as_array(gradient),
        grad_table.numpy() if learns else None,
        grad_coordinates.numpy() if moves else None,
    )
    return grad_coordinates, grad_table


@_encode_backward.register_fake
def _(
    coordinates: Tensor,
    table: Tensor,
    resolutions: Sequence[int],
    log2_entries: int,
    gradient: Tensor,
    moves: bool,
    learns: bool,
) -> tuple[Tensor, Tensor]:
    return _empty_gradients(coordinates, table, moves, learns)


def _setup(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    coordinates, table, ctx.resolutions, ctx.log2_entries = inputs
    ctx.save_for_backward(coordinates, table)


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None, None, None]:
    moves, learns = (bool(needed) for needed in ctx.needs_input_grad[:2])
    grid = (*ctx.saved_tensors, ctx.resolutions, ctx.log2_entries)
    grad_coordinates, grad_table = _encode_backward(*grid, gradient, moves, learns)
    # Of resolutions and log2_entries there is none.
    return grad_coordinates if moves else None, grad_table if learns else None, None, None


_encode.register_autograd(_backward, setup_context=_setup)


def _empty_rows(coordinates: Tensor, table: Tensor, resolutions: Sequence[int]) -> Tensor:
    return coordinates.new_empty(coordinates.shape[0], len(resolutions) * table.shape[1])


def _empty_gradients(coordinates: Tensor, table: Tensor, moves: bool, learns: bool) -> tuple[Tensor, Tensor]:
    """Room for the gradients; of no points and no entries unless these are wanted."""
    return (
        coordinates.new_empty(coordinates.shape[0] if moves else 0, 3),
        table.new_empty(table.shape[0] if learns else 0, table.shape[1]),
    )
