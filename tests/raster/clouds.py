"""Random points with difficult cases, for tests of the renderers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from fourd.base.cameras import Camera

NAMES = ("xyz", "features", "radius", "density")


@dataclass(frozen=True)
class Cloud:
    """Arguments of render_points, float32."""

    xyz: Tensor
    features: Tensor
    radius: Tensor
    density: Tensor

    @property
    def arrays(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        return self.xyz, self.features, self.radius, self.density

    def to(self, dtype: torch.dtype) -> Cloud:
        return Cloud(*(array.to(dtype) for array in self.arrays))


def turned_camera(width: int, height: int) -> Camera:
    """Return a camera near z = -3 that looks along +z and is rotated by 0.2 radians about z. K has no skew."""
    angle = 0.2
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    focal = 1.1 * max(width, height)
    intrinsics = np.array([[focal, 0, width / 2 + 0.3], [0, 1.05 * focal, height / 2 - 0.2], [0, 0, 1]])
    return Camera(intrinsics, rotation, np.array([0.1, -0.2, 3.0]), width, height)


def random_cloud(rng: np.random.Generator, count: int, channels: int) -> Cloud:
    """Return points inside and outside the image, in random order, with many difficult cases.

    Some points are behind the camera or on the camera plane. Some discs are larger than the image or smaller than a
    pixel, and some are centred on the image border. Some depths are equal, and some densities are 0 or 1.
    """
    xyz = rng.uniform([-1.6, -1.6, -1], [1.6, 1.6, 1], (count, 3)).astype(np.float32)
    radius = np.exp(rng.uniform(np.log(0.02), np.log(0.4), count)).astype(np.float32)
    density = rng.uniform(0, 1, count).astype(np.float32)
    features = rng.uniform(-1, 1, (count, channels)).astype(np.float32)
    kind = rng.integers(0, 12, count)
    xyz[kind == 0, 2] = 0.25
    xyz[kind == 1] = xyz[kind == 1][:1]
    xyz[kind == 2, 2] = rng.choice(np.array([-3.0, -3.5, -6.0, -2.995], np.float32), (kind == 2).sum())
    radius[kind == 3] = 6.0
    radius[kind == 4] = 0.003
    density[kind == 5] = 0.0
    density[kind == 6] = 1.0
    xyz[kind == 7, 0] = 1.35
    xyz[kind == 8, 1] = -1.3
    return Cloud(*map(torch.from_numpy, (xyz, features, radius, density)))


def cloud_with_invalid_points(rng: np.random.Generator, count: int) -> tuple[Cloud, Tensor]:
    """Return a cloud and a mask (N,) of its valid points. About a third of the points are not valid: they contain NaN,
    infinity or a huge number."""
    cloud = random_cloud(rng, count, 3)
    bad = torch.from_numpy(rng.random(count) < 0.33)
    values = torch.tensor([float("nan"), float("inf"), -float("inf"), 3e38])
    for row in torch.nonzero(bad)[:, 0].tolist():
        value = values[int(rng.integers(0, 4))]
        where = int(rng.integers(0, 5))
        if where < 3:
            cloud.xyz[row, where] = value
        elif where == 3:
            cloud.radius[row] = value if value < 1e38 or not torch.isfinite(value) else float("nan")
        else:
            cloud.density[row] = value if not torch.isfinite(value) else float("nan")
    return cloud, ~bad
