"""Rays through the pixels of plates, normalised distances along rays, and importance sampling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from fourd.base.cameras import Camera

NEAR = 0.05
"""Minimum distance at which rays start. All distances along rays are in units of the contraction's radius."""
MAX_NEAR = 1.0
"""Maximum distance at which rays start, so that a part of every ray lies before ``LINEAR_UP_TO``."""
LINEAR_UP_TO = 2.0
"""Distance up to which the normalised distance is linear in distance. Beyond it, the normalised distance is linear in
inverse distance."""
FAR = 200.0
"""Distance at which rays end."""


@dataclass(frozen=True, eq=False)
class Rays:
    """R rays.

    Attributes:
        origins: (R, 3) world points at which the rays start.
        directions: (R, 3) unit vectors in world coordinates.
    """

    origins: Tensor
    directions: Tensor

    def __len__(self) -> int:
        return len(self.origins)

    def at(self, distances: Tensor, unit: float) -> Tensor:
        """Compute the world points (R, S, 3) at distances (R, S), given in multiples of ``unit`` world units."""
        return self.origins[:, None] + (distances * unit)[..., None] * self.directions[:, None]


def camera_rays(camera: Camera, pixels: Tensor) -> Rays:
    """Create the rays of an undistorted pinhole camera through image positions (R, 2), given as x and y in pixels."""
    to_world = torch.from_numpy(ray_matrix(camera))
    directions = functional.pad(pixels.double(), (0, 1), value=1.0) @ to_world.T
    origins = torch.tensor(camera.centre).expand_as(directions)
    return Rays(origins.float(), functional.normalize(directions, dim=1).float())


def ray_matrix(camera: Camera) -> NDArray[np.float64]:
    """Compute the (3, 3) matrix that maps a pixel (x, y, 1) to the direction of its ray in world coordinates. In camera
    coordinates, the direction has z = 1."""
    return np.asarray(camera.rotation.T @ np.linalg.inv(camera.intrinsics), np.float64)


@dataclass(frozen=True)
class RayRange:
    """The distances at which rays start and end, and their normalisation to [0, 1].

    Attributes:
        near: distance at which rays start, from NEAR to MAX_NEAR. What lies nearer to a camera is no part of the field.
    """

    near: float = NEAR

    @classmethod
    def from_near_plane(cls, near: float | None, unit: float) -> RayRange:
        """Create the range of rays that start at the near plane, but not before NEAR.

        A point at the near plane is never nearer to the camera than the plane's depth, which is its distance along the
        viewing axis. The field is fitted before the visual hull is known, so the near plane is the one of the static
        surfaces (:func:`fourd.reconstruction.training.points.near_plane.feature_near`). The scene's near plane can be
        at a smaller depth, because the subject may come closer to a camera, but the field contains only static
        surfaces.

        Args:
            near: depth of the near plane in world units, or None if no camera has enough features.
            unit: radius of the field's space contraction in world units.
        """
        return cls(NEAR if near is None else min(max(NEAR, near / unit), MAX_NEAR))

    def to_distance(self, normalized: Tensor) -> Tensor:
        """Convert normalised distances in [0, 1] to distances.

        Normalised distances in [0, 0.5] are mapped linearly to distances from ``near`` to 2. Those in [0.5, 1] are
        mapped to distances from 2 to 200, such that the inverse distance changes linearly.
        """
        near = self.near + 2 * normalized * (LINEAR_UP_TO - self.near)
        inverse = 1 / LINEAR_UP_TO + (2 * normalized - 1).clamp(min=0) * (1 / FAR - 1 / LINEAR_UP_TO)
        return torch.where(normalized < 0.5, near, 1 / inverse)

    def to_normalized(self, distance: Tensor) -> Tensor:
        """Apply the inverse of :meth:`to_distance`, clamped to [0, 1]."""
        near = (distance - self.near) / (2 * (LINEAR_UP_TO - self.near))
        far = 0.5 + 0.5 * (1 / distance.clamp(min=LINEAR_UP_TO) - 1 / LINEAR_UP_TO) / (1 / FAR - 1 / LINEAR_UP_TO)
        return torch.where(distance < LINEAR_UP_TO, near, far).clamp(0, 1)


def resample_edges(edges: Tensor, weights: Tensor, count: int, jitter: Tensor | None) -> Tensor:
    """Sample interval edges (R, count + 1) from histograms, such that all intervals have about the same weight.

    The method is stratified inverse transform sampling.

    Args:
        edges: (C + 1,) ascending edges of the histogram's bins.
        weights: (R, C) weights of the bins. Each weight is at least 0, and each row has a positive sum.
        count: number of intervals per ray.
        jitter: (R, count + 1) offset of each edge within its stratum, in [0, 1). The strata divide the cumulative
            weight of the histogram into count + 1 equal parts. If None, each edge is at the centre of its stratum.
    """
    cumulative = functional.pad(weights.cumsum(1), (1, 0))
    cumulative = cumulative / cumulative[:, -1:]
    offset = torch.full((1, 1), 0.5) if jitter is None else jitter
    target = ((torch.arange(count + 1) + offset) / (count + 1)).expand(len(weights), -1).contiguous()
    upper = torch.searchsorted(cumulative, target, right=True).clamp(1, weights.shape[1])
    low, high = cumulative.gather(1, upper - 1), cumulative.gather(1, upper)
    within = ((target - low) / (high - low).clamp(min=1e-9)).clamp(0, 1)
    return edges[upper - 1] + within * (edges[upper] - edges[upper - 1])
