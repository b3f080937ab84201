"""K-Planes: features of points in space and time, sampled from planes over pairs of the coordinates x, y, z and t."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from fourd.reconstruction.model.config import PlanesConfig
from fourd.rendering.ops.heads.layers import NO_TIME_PLANES, TimePlanes
from fourd.rendering.ops.heads.op import MAX_TIME_SAMPLES
from fourd.rendering.ops.planes.op import sample_planes

SPACE_PAIRS = ((0, 1), (0, 2), (1, 2))
TIME_PAIRS = ((0, 3), (1, 3), (2, 3))


class KPlanes(nn.Module):
    """Multi-resolution feature planes over (x, y, z, t) (Fridovich-Keil et al. 2023, sec. 3).

    Coordinates are (N, 4) float32, clamped to [-1, 1]. The first and last samples along each axis of a plane are at -1
    and 1 (``align_corners=True``). Time planes have one row per frame, but at least two. Features are differentiable in
    the planes and in the coordinates. Each plane has the shape (rows, columns, features), so that all features of one
    sample are adjacent in memory.
    """

    def __init__(self, config: PlanesConfig, sides: tuple[float, float, float], frame_count: int) -> None:
        """Create the planes. ``sides`` are the side lengths of the bounds, in any unit. The planes have the full
        resolution along the longest side, and a resolution proportional to the side length along the other sides."""
        super().__init__()
        self.config = config
        pairs = SPACE_PAIRS + (TIME_PAIRS if config.time else ())
        self.pairs = pairs
        planes = []
        for level in range(config.levels):
            resolution = config.base_resolution * config.multiplier**level
            cells = [max(2, round(resolution * side / max(sides))) for side in sides] + [max(2, frame_count)]
            for first, second in pairs:
                planes.append(nn.Parameter(self._initial_plane(cells[first], cells[second], second == 3)))
        self.planes = nn.ParameterList(planes)

    @property
    def out_features(self) -> int:
        """Number of output channels. The reduction "concat" keeps the channels of all planes of all levels. The
        reductions "sum" and "product" combine the planes of each level into the channels of one plane."""
        planes = len(self.pairs) if self.config.reduction == "concat" else 1
        return self.config.levels * self.config.features * planes

    @property
    def time_plane_indices(self) -> list[int]:
        """Indices in ``planes`` of the planes with a time axis, which have one row per frame."""
        return [index for index in range(len(self.planes)) if self.pairs[index % len(self.pairs)] in TIME_PAIRS]

    def forward(self, coordinates: Tensor) -> Tensor:
        """Sample features (N, out_features) at coordinates (N, 4) in [-1, 1]."""
        axes = [axis for pair in self.pairs for axis in pair] * self.config.levels
        samples = sample_planes(coordinates, list(self.planes), axes)
        if self.config.reduction == "concat":
            return samples
        separate = samples.reshape(-1, self.config.levels, len(self.pairs), self.config.features)
        reduced = separate.sum(dim=2) if self.config.reduction == "sum" else separate.prod(dim=2)
        return reduced.flatten(1)

    def split_features(self, coordinates: Tensor, time: float) -> tuple[Tensor, TimePlanes]:
        """Sample the planes over space at coordinates (N, 4) in [-1, 1] that all have the same ``time``, and return the
        time planes, from which the heads sample the other features of ``forward``. If there are too many samples along
        the coordinates of the time planes, or if features of different planes are combined, all planes are sampled."""
        indices = self.time_plane_indices
        lines = [self.planes[index] for index in indices]
        samples = sum(line.shape[1] for line in lines)
        if self.config.reduction != "concat" or not lines or samples > MAX_TIME_SAMPLES:
            return self(coordinates), NO_TIME_PLANES
        others = [index for index in range(len(self.planes)) if index not in indices]
        pairs = [self.pairs[index % len(self.pairs)] for index in range(len(self.planes))]
        features = sample_planes(
            coordinates, [self.planes[index] for index in others], [axis for index in others for axis in pairs[index]]
        )
        columns = [index * self.config.features for index in indices]
        return features, TimePlanes(lines, [pairs[index][0] for index in indices], columns, coordinates, time)

    def _initial_plane(self, columns: int, rows: int, is_time: bool) -> Tensor:
        shape = (rows, columns, self.config.features)
        if self.config.reduction == "product":
            # As in the K-Planes paper, no plane is initialised to 0, because the gradient of a product of zeros is 0.
            # Time planes are initialised to 1, so that the initial features do not depend on time.
            return torch.ones(shape) if is_time else torch.empty(shape).uniform_(0.1, 0.5)
        return torch.empty(shape).uniform_(-0.05, 0.05)
