"""Smoothness losses for separate triangles: neighbours should lie in a common plane and have similar normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn import functional

NEIGHBOURS = 8
"""Maximum number of neighbours of each triangle."""


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Pairs of neighbouring triangles on the same side of the surface.

    Attributes:
        first: (P,) int64 triangle indices.
        second: (P,) int64 indices of neighbours of the triangles in ``first``.
    """

    first: Tensor
    second: Tensor

    @staticmethod
    @torch.no_grad()
    def of(corners: Tensor) -> Neighbours:
        """Find the K nearest triangles of each triangle, where K is :data:`NEIGHBOURS`, and pair the triangle with
        those of them whose normals differ from its own normal by less than 90 degrees. ``corners`` (T, 3, 3) are the
        vertices of all triangles."""
        centres, normals = corners.mean(dim=1), unit_normals(corners)
        count = min(NEIGHBOURS + 1, len(corners))
        tree = cKDTree(centres.numpy())
        found = tree.query(centres.numpy(), k=count, workers=1)[1].reshape(len(corners), count)
        second = torch.from_numpy(np.ascontiguousarray(found[:, 1:], dtype=np.int64)).flatten()
        first = torch.arange(len(corners)).repeat_interleave(count - 1)
        same_side = (normals[first] * normals[second]).sum(dim=1) > 0
        return Neighbours(first[same_side], second[same_side])


def unit_normals(corners: Tensor) -> Tensor:
    """Return the outward unit normals (T, 3) of triangles (T, 3, 3) that are counter-clockwise seen from outside. The
    normals of triangles without area are 0."""
    a, b, c = corners.unbind(1)
    return functional.normalize(torch.linalg.cross(b - a, c - a), dim=1, eps=1e-20)


def smoothness_loss(corners: Tensor, neighbours: Neighbours, spacing: float) -> tuple[Tensor, Tensor]:
    """Measure how much neighbouring triangles deviate from a common plane. ``corners`` (T, 3, 3) are the triangles'
    vertices.

    Returns:
        two losses. The first is the mean Huber loss of the distances of the neighbours' centres from the triangles'
        planes, in units of ``spacing``. The second is the mean of 1 - cos(angle between the normals of two neighbours).
        Both are 0 if there are no neighbours.
    """
    centres, normals = corners.mean(dim=1), unit_normals(corners)
    if len(neighbours.first) == 0:
        return corners.new_zeros(()), corners.new_zeros(())
    offset = centres.index_select(0, neighbours.second) - centres.index_select(0, neighbours.first)
    normal = normals.index_select(0, neighbours.first)
    height = (offset * normal).sum(dim=1) / spacing
    plane = functional.huber_loss(height, torch.zeros_like(height), delta=1.0)
    cosine = (normal * normals.index_select(0, neighbours.second)).sum(dim=1)
    return plane, (1 - cosine).mean()
