"""Shadows and reflected light that the dynamic foreground casts on the background around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from fourd.reconstruction.model.config import PlanesConfig
from fourd.reconstruction.model.kplanes import KPlanes

PLANES = PlanesConfig(levels=2, features=4, base_resolution=64)
HIDDEN = 32
MARGIN = 0.5
"""Margin of the field around the foreground's bounds, as a fraction of the bounds' longest side."""
FADE = 0.25
"""Width of the zone along the border of the field in which shadows fade out, as a fraction of the distance from the
centre to the border. Without this zone, shadows would end in a sharp edge."""
GAIN = 3.0
"""Factor that multiplies the MLP's output. It makes the field learn faster, which is needed because each frame is
rendered in only a few training steps."""
STRENGTH = 127 / 128
"""Shadow factors lie between 1 - STRENGTH and 1 + STRENGTH, so that a byte can store them in units of 1/128."""


@dataclass(frozen=True)
class Shadow:
    """The shadow on N points at one time.

    Attributes:
        factor: (N,) factor in (0, 2) that multiplies image-based colours; 1 where there is no shadow. It is
            differentiable in the parameters of the shadow field.
        is_inside: (N,) bool, true for points inside the shadow field.
    """

    factor: Tensor
    is_inside: Tensor

    def apply(self, colour: Tensor) -> Tensor:
        """Multiply image-based colours (N, 3) by the shadow factor. For points inside the field, the gradient flows
        only to the shadow factor, not to ``colour``; see :meth:`detach_inside`."""
        return self.detach_inside(colour) * self.factor[:, None]

    def detach_inside(self, colour: Tensor) -> Tensor:
        """Return ``colour`` (N, 3) unchanged, but without a gradient for points inside the field.

        Some training steps compare the background with clean plates (images without the foreground), others compare the
        whole scene with frames. Inside the field, the background's colours learn only from the clean plates, and the
        steps on frames train the shadow.
        """
        return torch.where(self.is_inside[:, None], colour.detach(), colour)


class ShadowField(nn.Module):
    """A small K-Planes model with time planes, followed by a small MLP. It covers the foreground's bounds, extended by
    a margin.

    The shadow factor is ``1 + STRENGTH * fade * tanh(GAIN * (MLP(planes(x, t)) - MLP(0)))``, where ``fade`` decreases
    linearly from 1 to 0 in the border zone; see FADE. Because the planes are initialised to 0, the factor is exactly 1
    before training, and it remains 1 wherever the planes never get a gradient.
    """

    lower: Tensor
    upper: Tensor

    def __init__(self, lower: NDArray[np.float64], upper: NDArray[np.float64], frame_count: int) -> None:
        """Create the field around the foreground's bounds, whose corners are ``lower`` and ``upper`` (3,) in world
        units."""
        super().__init__()
        margin = MARGIN * float((upper - lower).max())
        self.register_buffer("lower", torch.tensor(lower - margin, dtype=torch.float32))
        self.register_buffer("upper", torch.tensor(upper + margin, dtype=torch.float32))
        x, y, z = (float(side) for side in self.upper - self.lower)
        self.planes = KPlanes(PLANES, (x, y, z), frame_count)
        for plane in self.planes.parameters():
            nn.init.zeros_(plane)
        self.layers = nn.Sequential(
            nn.Linear(self.planes.out_features, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, 1, bias=False)
        )

    def forward(self, xyz: Tensor, time: float) -> Shadow:
        """Compute the shadow on points (N, 3) in world units at ``time`` in [0, 1]. Positions get no gradient."""
        position = 2 * (xyz.detach() - self.lower) / (self.upper - self.lower) - 1
        edge = position.abs().amax(dim=1)
        is_inside = edge < 1
        rows = is_inside.nonzero()[:, 0]
        times = torch.full((len(rows), 1), 2 * time - 1, device=xyz.device)
        features = self.planes(torch.cat([position[rows], times], dim=1))
        raw = (self.layers(features) - self.layers(torch.zeros_like(features[:1])))[:, 0]
        fade = ((1 - edge[rows]) / FADE).clamp(max=1)
        factor = 1 + STRENGTH * fade * torch.tanh(GAIN * raw)
        return Shadow(torch.ones_like(edge).index_put((rows,), factor), is_inside)

    def mean_squared_deviation(self, xyz: Tensor, time: float) -> Tensor:
        """Compute the mean of (factor - 1)^2 over the points inside the field, as a scalar. Points of ``xyz`` (N, 3)
        outside the field are ignored."""
        shadow = self(xyz, time)
        return (shadow.factor - 1).square().sum() / shadow.is_inside.sum().clamp(min=1)
