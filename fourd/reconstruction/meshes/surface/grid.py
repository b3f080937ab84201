"""Tetrahedral grids that cover a set of cubes.

The vertices are the corners and the centres of the cubes, which form a body-centred cubic lattice. Each face that two
cubes share produces four tetrahedra, one for each edge of the face. The tetrahedron of an edge has four vertices: the
two ends of the edge and the centres of the two cubes. All tetrahedra are congruent, and their dihedral angles are 60
and 90 degrees (Labelle and Shewchuk 2007, sec. 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

_KEY_BITS = 20
"""Number of bits of each coordinate in the integer key that identifies a lattice vertex (see :func:`_keys`)."""

_FACE = ((0, 0), (1, 0), (1, 1), (0, 1))
"""Corners of a cube's face, in order around the face."""


@dataclass(frozen=True, eq=False)
class TetrahedralGrid:
    """A tetrahedral grid.

    Attributes:
        xyz: (V, 3) float32 positions of the vertices, in world units.
        tetrahedra: (T, 4) int64 vertex indices. The edges from a tetrahedron's first vertex to the other three form a
            matrix with a positive determinant.
        is_border: (V,) bool, true for vertices on the border of the grid.
        side: side length of a cube in world units.
    """

    xyz: Tensor
    tetrahedra: Tensor
    is_border: Tensor
    side: float


def box_grid(lower: NDArray[np.floating], upper: NDArray[np.floating], cells: int) -> TetrahedralGrid:
    """Create a grid that covers a box with at least ``cells`` cubes along its longest side.

    Args:
        lower: (3,) corner of the box with the smallest coordinates.
        upper: (3,) corner of the box with the largest coordinates.
        cells: minimum number of cubes along the longest side, at least 1.

    Raises:
        ValueError: if the box is empty or ``cells`` is below 1.
    """
    extent = np.asarray(upper, np.float64) - np.asarray(lower, np.float64)
    if not (extent > 0).all():
        raise ValueError(f"upper: expected more than lower {np.asarray(lower)}, got {np.asarray(upper)}")
    if cells < 1:
        raise ValueError(f"cells: expected at least 1, got {cells}")
    side = float(extent.max()) / cells
    counts = np.ceil(extent / side - 1e-9).astype(np.int64) + 2
    cubes = np.stack(np.meshgrid(*(np.arange(count) for count in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    first = (np.asarray(lower, np.float64) + np.asarray(upper, np.float64) - counts * side) / 2
    return cube_grid(cubes, first, side)


def cube_grid(cubes: NDArray[np.integer], lower: NDArray[np.floating], side: float) -> TetrahedralGrid:
    """Create a grid from cubes of a regular lattice. Only pairs of cubes that share a face produce tetrahedra.

    Args:
        cubes: (N, 3) distinct integer cube positions, from 0 to 2^18.
        lower: (3,) world position of the lower corner of the cube (0, 0, 0).
        side: side length of a cube in world units, more than 0.

    Raises:
        ValueError: if a position is out of range, no two cubes share a face, or ``side`` is not positive.
    """
    cubes = np.asarray(cubes, np.int64).reshape(-1, 3)
    if not side > 0:
        raise ValueError(f"side: expected more than 0, got {side}")
    if cubes.size and (cubes.min() < 0 or cubes.max() > 1 << (_KEY_BITS - 2)):
        raise ValueError(
            f"cubes: expected positions from 0 to {1 << (_KEY_BITS - 2)}, got {cubes.min()}..{cubes.max()}"
        )
    corners = np.concatenate([_tetrahedra_along(cubes, axis) for axis in range(3)])
    if len(corners) == 0:
        raise ValueError(f"cubes: expected two cubes that share a face, got {len(cubes)} cubes without such a pair")
    keys, indices = np.unique(_keys(corners), return_inverse=True)
    tetrahedra = indices.reshape(-1, 4)
    halves = np.stack([keys >> (2 * _KEY_BITS), keys >> _KEY_BITS & (1 << _KEY_BITS) - 1, keys & (1 << _KEY_BITS) - 1])
    xyz = np.asarray(lower, np.float64) + halves.T * (side / 2)
    return TetrahedralGrid(
        torch.from_numpy(xyz.astype(np.float32)),
        torch.from_numpy(tetrahedra),
        torch.from_numpy(_border_vertices(tetrahedra, len(keys))),
        side,
    )


def _tetrahedra_along(cubes: NDArray[np.int64], axis: int) -> NDArray[np.int64]:
    """Return the corners (T, 4, 3) of the tetrahedra between cubes that are neighbours along ``axis``. Coordinates are
    in units of half a cube side."""
    step = np.zeros(3, np.int64)
    step[axis] = 1
    keys = np.sort(_keys(cubes))
    lower_cubes = cubes[np.isin(_keys(cubes + step), keys, assume_unique=False)]
    first, second = 2 * lower_cubes + 1, 2 * (lower_cubes + step) + 1
    across, along = (axis + 1) % 3, (axis + 2) % 3
    ring = []
    for u, v in _FACE:
        corner = 2 * (lower_cubes + step)
        corner[:, across] += 2 * u
        corner[:, along] += 2 * v
        ring.append(corner)
    parts = [np.stack([first, second, ring[i], ring[(i + 1) % 4]], axis=1) for i in range(4)]
    return np.concatenate(parts)


def _keys(positions: NDArray[np.int64]) -> NDArray[np.int64]:
    """Pack the three coordinates of each integer position into one integer, a key that identifies the position.

    The last axis of ``positions`` has the three coordinates. The result lacks this axis.
    """
    x, y, z = np.moveaxis(positions, -1, 0)
    return (x << (2 * _KEY_BITS)) | (y << _KEY_BITS) | z


def _border_vertices(tetrahedra: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
    """Return a mask (V,) that is true for the vertices of faces that belong to only one tetrahedron."""
    faces = np.sort(np.concatenate([np.delete(tetrahedra, corner, axis=1) for corner in range(4)]), axis=1)
    # A face that two tetrahedra share occurs twice. Sorting makes the two copies adjacent.
    order = np.lexsort(faces.T)
    ordered = faces[order]
    is_first = np.ones(len(ordered), np.bool_)
    is_first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    is_last = np.append(is_first[1:], True)
    border = np.zeros(count, np.bool_)
    border[ordered[is_first & is_last].ravel()] = True
    return border
