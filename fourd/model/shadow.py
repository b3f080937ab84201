"""Shadows and contact: what the subject takes of the light, or adds to it, on the background around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from fourd.model.config import PlanesConfig
from fourd.model.kplanes import KPlanes

PLANES = PlanesConfig(levels=2, features=4, base_resolution=64)
HIDDEN = 32
REACH = 0.5
"""Shadows reach beyond what moves by this share of its longest side."""
FADE = 0.25
"""Over this share of the way from the border to the middle they come in, so that nothing ends at an edge."""
GAIN = 3.0
"""Times the MLP's output: a frame is seen in few steps, and its shadow has to come in these."""
STRENGTH = 127 / 128
"""Factors are within 1 plus and minus this, which bytes in 1/128 hold."""


@dataclass(frozen=True)
class Shadow:
    """What falls on N points at one moment.

    Attributes:
        factor: (N,) in (0, 2), for colours from images; 1 where nothing falls. Differentiable in the field.
        reached: (N,) bool, where something can fall.
    """

    factor: Tensor
    reached: Tensor

    def cast(self, colour: Tensor) -> Tensor:
        """Colours (N, 3) from images, in the shadow; see :meth:`kept`."""
        return self.kept(colour) * self.factor[:, None]

    def kept(self, colour: Tensor) -> Tensor:
        """Colours (N, 3) as they are, but that none is learnt where something can fall: the clean plates teach
        these, and the picture of a moment teaches its shadow alone."""
        return torch.where(self.reached[:, None], colour.detach(), colour)


class ShadowField(nn.Module):
    """A small K-Planes with time, and an MLP, over the bounds of what moves and their surroundings.

    ``factor = 1 + STRENGTH * fade * tanh(GAIN * (MLP(planes(x, t)) - MLP(0)))``. The planes begin at 0, so that it is
    exactly 1 before training, and stays so where no picture ever asked for another.
    """

    lower: Tensor
    upper: Tensor

    def __init__(self, lower: NDArray[np.float64], upper: NDArray[np.float64], frame_count: int) -> None:
        """``lower`` and ``upper`` (3,) are the corners of what moves in world units; one row of planes a frame."""
        super().__init__()
        beyond = REACH * float((upper - lower).max())
        self.register_buffer("lower", torch.tensor(lower - beyond, dtype=torch.float32))
        self.register_buffer("upper", torch.tensor(upper + beyond, dtype=torch.float32))
        x, y, z = (float(side) for side in self.upper - self.lower)
        self.planes = KPlanes(PLANES, (x, y, z), frame_count)
        for plane in self.planes.parameters():
            nn.init.zeros_(plane)
        self.layers = nn.Sequential(
            nn.Linear(self.planes.out_features, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, 1, bias=False)
        )

    def forward(self, xyz: Tensor, time: float) -> Shadow:
        """What falls on points (N, 3) in world units at ``time`` in [0, 1]; positions get no gradient."""
        place = 2 * (xyz.detach() - self.lower) / (self.upper - self.lower) - 1
        edge = place.abs().amax(dim=1)
        reached = edge < 1
        rows = reached.nonzero()[:, 0]
        moment = torch.full((len(rows), 1), 2 * time - 1)
        features = self.planes(torch.cat([place[rows], moment], dim=1))
        raw = (self.layers(features) - self.layers(torch.zeros_like(features[:1])))[:, 0]
        fade = ((1 - edge[rows]) / FADE).clamp(max=1)
        some = 1 + STRENGTH * fade * torch.tanh(GAIN * raw)
        return Shadow(torch.ones_like(edge).index_put((rows,), some), reached)

    def departure(self, xyz: Tensor, time: float) -> Tensor:
        """Mean squared difference from 1 of the factors on those of the points (N, 3) that are reached; () tensor."""
        shadow = self(xyz, time)
        return (shadow.factor - 1).square().sum() / shadow.reached.sum().clamp(min=1)
