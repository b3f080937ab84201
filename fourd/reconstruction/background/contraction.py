"""Contraction of unbounded space into a ball (mip-NeRF 360, Barron et al. 2022, eq. 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera

CONTRACTED_RADIUS = 2.0
"""Radius of the ball in contracted space. Points at infinity map to its surface. Inside radius 1, the contraction is
the identity."""


@dataclass(frozen=True)
class Contraction:
    """The contraction of mip-NeRF 360 about a world point.

    Attributes:
        centre: world point that maps to the centre of the ball.
        radius: radius of the inner region in world units. Points in the inner region are only translated and scaled.
    """

    centre: tuple[float, float, float]
    radius: float

    def __call__(self, xyz: Tensor) -> Tensor:
        """Map world points (..., 3) into a ball of radius 2. The map is differentiable."""
        centre = torch.tensor(self.centre, dtype=xyz.dtype, device=xyz.device)
        near = (xyz - centre) / self.radius
        length = torch.linalg.vector_norm(near, dim=-1, keepdim=True).clamp(min=1.0)
        return near * ((CONTRACTED_RADIUS - 1 / length) / length)

    def to_unit(self, xyz: Tensor) -> Tensor:
        """Map world points (..., 3) into the unit cube, where each coordinate is in [0, 1]. The map is
        differentiable."""
        return (self(xyz) + CONTRACTED_RADIUS) / (2 * CONTRACTED_RADIUS)


def contraction_around(cameras: Sequence[Camera], focus: NDArray[np.float64]) -> Contraction:
    """Create a contraction about the point ``focus`` (3,), with an inner region that contains all cameras."""
    distances = [float(np.linalg.norm(camera.centre - focus)) for camera in cameras]
    x, y, z = (float(value) for value in focus)
    return Contraction((x, y, z), max(*distances, 1e-6))
