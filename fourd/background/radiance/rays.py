"""Rays of plates, and how distances along them are shared out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from fourd.cameras import Camera

NEAR = 0.05
LINEAR_UP_TO = 2.0
FAR = 200.0
"""In units of the contraction's radius, as all distances along rays."""


@dataclass(frozen=True, eq=False)
class Rays:
    """R rays.

    Attributes:
        origins: (R, 3) world.
        directions: (R, 3) world, unit.
    """

    origins: Tensor
    directions: Tensor

    def __len__(self) -> int:
        return len(self.origins)

    def at(self, distances: Tensor, unit: float) -> Tensor:
        """World points (R, S, 3) at distances (R, S), which are in units of ``unit`` world units."""
        return self.origins[:, None] + (distances * unit)[..., None] * self.directions[:, None]


def camera_rays(camera: Camera, pixels: Tensor) -> Rays:
    """Rays through places (R, 2), x and y in pixels, of an undistorted pinhole's picture."""
    to_world = torch.from_numpy(ray_matrix(camera))
    directions = functional.pad(pixels.double(), (0, 1), value=1.0) @ to_world.T
    origins = torch.tensor(camera.centre).expand_as(directions)
    return Rays(origins.float(), functional.normalize(directions, dim=1).float())


def ray_matrix(camera: Camera) -> NDArray[np.float64]:
    """(3, 3): takes (x, y, 1) in pixels to the ray's direction in the world, as long as the ray is at depth 1."""
    return np.asarray(camera.rotation.T @ np.linalg.inv(camera.intrinsics), np.float64)


def to_distance(share: Tensor) -> Tensor:
    """Share of a ray in [0, 1] -> distance: even from 0.05 to 2 in the first half, then even in its inverse to 200."""
    near = NEAR + 2 * share * (LINEAR_UP_TO - NEAR)
    inverse = 1 / LINEAR_UP_TO + (2 * share - 1).clamp(min=0) * (1 / FAR - 1 / LINEAR_UP_TO)
    return torch.where(share < 0.5, near, 1 / inverse)


def to_share(distance: Tensor) -> Tensor:
    """The inverse of :func:`to_distance`; what is nearer or farther gets 0 or 1."""
    near = (distance - NEAR) / (2 * (LINEAR_UP_TO - NEAR))
    far = 0.5 + 0.5 * (1 / distance.clamp(min=LINEAR_UP_TO) - 1 / LINEAR_UP_TO) / (1 / FAR - 1 / LINEAR_UP_TO)
    return torch.where(distance < LINEAR_UP_TO, near, far).clamp(0, 1)


def resampled(edges: Tensor, weights: Tensor, count: int, jitter: Tensor | None) -> Tensor:
    """Edges (R, count + 1) of intervals that have about equal parts of a histogram each.

    Args:
        edges: (C + 1,) ascending, of the histogram's bins.
        weights: (R, C), not negative, not all 0 in a row.
        count: of intervals.
        jitter: (R, count + 1) in [0, 1) moves each edge within its part; None takes the middles.
    """
    cumulative = functional.pad(weights.cumsum(1), (1, 0))
    cumulative = cumulative / cumulative[:, -1:]
    offset = torch.full((1, 1), 0.5) if jitter is None else jitter
    wanted = ((torch.arange(count + 1) + offset) / (count + 1)).expand(len(weights), -1).contiguous()
    upper = torch.searchsorted(cumulative, wanted, right=True).clamp(1, weights.shape[1])
    low, high = cumulative.gather(1, upper - 1), cumulative.gather(1, upper)
    share = ((wanted - low) / (high - low).clamp(min=1e-9)).clamp(0, 1)
    return edges[upper - 1] + share * (edges[upper] - edges[upper - 1])
