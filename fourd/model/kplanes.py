"""K-Planes: a point of space and time looked up in planes over pairs of its coordinates."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from fourd.model.config import PlanesConfig
from fourd.ops.planes.op import sample_planes

SPACE_PAIRS = ((0, 1), (0, 2), (1, 2))
TIME_PAIRS = ((0, 3), (1, 3), (2, 3))


class KPlanes(nn.Module):
    """Multi-resolution feature planes over (x, y, z, t) (Fridovich-Keil et al. 2023, sec. 3).

    Coordinates are (N, 4) float32 in [-1, 1] for x, y, z and t; those outside are clamped to
    the border. Both space and time put their first and last samples on the borders
    (align_corners), so that with F frames the time planes have one row a frame.
    The result is (N, out_features), differentiable in the planes and the coordinates. A plane is
    (rows, columns, features), so that what a point reads lies together.
    """

    def __init__(self, config: PlanesConfig, sides: tuple[float, float, float], frame_count: int) -> None:
        """``sides`` are the lengths of the bounds (any unit); the longest gets the full resolution."""
        super().__init__()
        self.config = config
        pairs = SPACE_PAIRS + (TIME_PAIRS if config.time else ())
        self.pairs = pairs
        planes = []
        for level in range(config.levels):
            resolution = config.base_resolution * config.multiplier**level
            cells = [max(2, round(resolution * side / max(sides))) for side in sides] + [max(2, frame_count)]
            for first, second in pairs:
                planes.append(nn.Parameter(self._initial(cells[first], cells[second], second == 3)))
        self.planes = nn.ParameterList(planes)

    @property
    def out_features(self) -> int:
        """Channels of the result: all planes and levels for concat, all levels otherwise."""
        joined = len(self.pairs) if self.config.reduction == "concat" else 1
        return self.config.levels * self.config.features * joined

    def forward(self, coordinates: Tensor) -> Tensor:
        """(N, 4) coordinates in [-1, 1] -> (N, out_features)."""
        axes = [axis for pair in self.pairs for axis in pair] * self.config.levels
        samples = sample_planes(coordinates, list(self.planes), axes)
        if self.config.reduction == "concat":
            return samples
        apart = samples.reshape(-1, self.config.levels, len(self.pairs), self.config.features)
        joined = apart.sum(dim=2) if self.config.reduction == "sum" else apart.prod(dim=2)
        return joined.flatten(1)

    def _initial(self, cells_x: int, cells_y: int, is_time: bool) -> Tensor:
        shape = (cells_y, cells_x, self.config.features)
        if self.config.reduction == "product":
            # A product must start away from zero or no plane learns; K-Planes starts time at one.
            return torch.ones(shape) if is_time else torch.empty(shape).uniform_(0.1, 0.5)
        return torch.empty(shape).uniform_(-0.05, 0.05)
