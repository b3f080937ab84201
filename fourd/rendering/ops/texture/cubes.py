"""Geometry of cube maps in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

# For each face, the directions of its s axis, its t axis and its outward normal, as in OpenGL.
_FACES = (
    ((0, 0, -1), (0, -1, 0), (1, 0, 0)),
    ((0, 0, 1), (0, -1, 0), (-1, 0, 0)),
    ((1, 0, 0), (0, 0, 1), (0, 1, 0)),
    ((1, 0, 0), (0, 0, -1), (0, -1, 0)),
    ((1, 0, 0), (0, -1, 0), (0, 0, 1)),
    ((-1, 0, 0), (0, -1, 0), (0, 0, -1)),
)


def face_axes(like: Tensor) -> Tensor:
    """Return the s axis, the t axis and the normal of each face, (6, 3, 3)."""
    return torch.tensor(_FACES, dtype=like.dtype, device=like.device)


def face_of(direction: Tensor) -> Tensor:
    """For rays from the cube's centre with the given directions, return the index of the face that each ray meets. The
    last axis of ``direction`` has the three coordinates, and the result lacks this axis.

    A ray through an edge or a corner of the cube meets several faces. The x face has priority over the y face, and the
    y face over the z face.
    """
    size = direction.detach().abs()
    x, y, z = size.unbind(-1)
    axis = torch.where((z > x) & (z > y), 2, torch.where(y > x, 1, 0))
    along = direction.detach().gather(-1, axis[..., None])[..., 0]
    return 2 * axis + (along < 0).long()


def project(direction: Tensor, face: Tensor) -> Tensor:
    """For rays from the cube's centre with the given directions, return the position at which each ray meets its face.
    ``face`` is the result of :func:`face_of`. Coordinates on a face are in [0, 1].

    The last axis of ``direction`` has three coordinates, and the last axis of the result has two. The positions are
    differentiable in the directions.
    """
    axes = face_axes(direction)[face]
    a, b, m = (axes @ direction[..., None])[..., 0].unbind(-1)
    return torch.stack([0.5 * a / m + 0.5, 0.5 * b / m + 0.5], dim=-1)


def pad_cube(level: Tensor) -> Tensor:
    """Extend faces (items, 6, N, N, C) on each side by one texel of the neighbouring face. Return
    (items, 6, N + 2, N + 2, C).

    The cube has no texel beyond a corner of a face, so the mean of the three texels that meet there is used.
    """
    size = level.shape[2]
    centres = (2 * torch.arange(-1, size + 1, dtype=torch.float64) + 1) / size - 1
    b, a = torch.meshgrid(centres, centres, indexing="ij")
    axes = face_axes(centres)
    s_axis, t_axis, normal = (axes[:, k, None, None, :] for k in range(3))
    # Beyond an edge of a face, the cube's surface continues at a right angle, opposite to the face's normal.
    beyond = (a.abs().clamp(min=1) - 1) + (b.abs().clamp(min=1) - 1)
    plane = a.clamp(-1, 1)[..., None] * s_axis + b.clamp(-1, 1)[..., None] * t_axis
    position = plane + (1 - beyond)[..., None] * normal
    # A slight shift of the positions resolves ties between two faces in favour of the neighbouring face.
    position = position + 1e-9 * (a.sign() * (a.abs() > 1))[..., None] * s_axis
    position = position + 1e-9 * (b.sign() * (b.abs() > 1))[..., None] * t_axis
    face = face_of(position)
    column, row = (project(position, face) * size).floor().long().clamp(0, size - 1).unbind(-1)
    padded = level[:, face.to(level.device), row.to(level.device), column.to(level.device)]
    return _fill_corners(padded)


def _fill_corners(padded: Tensor) -> Tensor:
    last = padded.shape[2] - 1
    mask = torch.zeros(last + 1, last + 1, 1, dtype=torch.bool, device=padded.device)
    corners = torch.zeros_like(padded)
    for row, inner_row in ((0, 1), (last, last - 1)):
        for column, inner_column in ((0, 1), (last, last - 1)):
            three = (
                padded[:, :, inner_row, column]
                + padded[:, :, row, inner_column]
                + padded[:, :, inner_row, inner_column]
            )
            corner = torch.zeros_like(mask)
            corner[row, column] = True
            corners = torch.where(corner, (three / 3)[:, :, None, None], corners)
            mask = mask | corner
    return torch.where(mask, corners, padded)
