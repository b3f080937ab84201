"""All of space in a ball: what is near keeps its shape, and what is far is drawn in (Barron et al. 2022, eq. 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.cameras import Camera

CONTRACTED_RADIUS = 2.0
"""Radius of the ball that infinity lies on; the part that keeps its shape has radius 1."""


@dataclass(frozen=True)
class Contraction:
    """mip-NeRF 360's contraction about a world point.

    Attributes:
        centre: world point in the middle.
        radius: world units; what is nearer to the centre keeps its shape.
    """

    centre: tuple[float, float, float]
    radius: float

    def __call__(self, xyz: Tensor) -> Tensor:
        """World points (..., 3) -> (..., 3) in a ball of radius 2; differentiable."""
        centre = torch.tensor(self.centre, dtype=xyz.dtype, device=xyz.device)
        near = (xyz - centre) / self.radius
        length = torch.linalg.vector_norm(near, dim=-1, keepdim=True).clamp(min=1.0)
        return near * ((CONTRACTED_RADIUS - 1 / length) / length)

    def to_unit(self, xyz: Tensor) -> Tensor:
        """World points (..., 3) -> (..., 3) in [0, 1]; differentiable."""
        return (self(xyz) + CONTRACTED_RADIUS) / (2 * CONTRACTED_RADIUS)


def contraction_around(cameras: Sequence[Camera], focus: NDArray[np.float64]) -> Contraction:
    """The contraction about ``focus`` (3,) world, what the cameras look at, that keeps the shape up to the cameras."""
    distances = [float(np.linalg.norm(camera.centre - focus)) for camera in cameras]
    x, y, z = (float(value) for value in focus)
    return Contraction((x, y, z), max(*distances, 1e-6))
