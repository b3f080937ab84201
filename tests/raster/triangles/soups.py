"""Random triangles with difficult cases, for tests of the renderers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

NAMES = ("xyz", "features", "opacity", "sigma")


@dataclass(frozen=True)
class Soup:
    """Arguments of splat_triangles, float32 and int32."""

    xyz: Tensor
    tri: Tensor
    features: Tensor
    opacity: Tensor
    sigma: Tensor

    @property
    def floats(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        return self.xyz, self.features, self.opacity, self.sigma


def random_soup(rng: np.random.Generator, count: int, channels: int = 3, size: float = 0.3) -> Soup:
    """Return triangles inside and outside the image of ``turned_camera``, in random order, with many difficult cases.

    Some triangles are repeated, degenerate or very thin. Some triangles are behind the camera or cross the camera
    plane. Some triangles are larger than the image, smaller than a pixel or centred on the image border. Some depths
    are equal, some opacities are 0, 1/255 or 1, and sigmas are small or large. A third of the triangles share vertices
    with other triangles.
    """
    centre = rng.uniform([-1.6, -1.6, -1], [1.6, 1.6, 1], (count, 1, 3))
    corners = (centre + size * rng.normal(size=(count, 3, 3))).astype(np.float32)
    opacity = rng.uniform(0.05, 1, count).astype(np.float32)
    sigma = np.exp(rng.uniform(np.log(0.1), np.log(3), count)).astype(np.float32)
    kind = rng.integers(0, 14, count)
    corners[kind == 0, :, 2] = 0.25
    corners[kind == 1] = corners[kind == 1][:1]
    corners[kind == 2, :, 2] -= 3.5
    corners[kind == 3, 2] = corners[kind == 3, 0] * 0.5 + corners[kind == 3, 1] * 0.5
    corners[kind == 4] *= 8
    corners[kind == 5] = corners[kind == 5, :1] + 0.01 * (corners[kind == 5] - corners[kind == 5, :1])
    opacity[kind == 6] = 0
    opacity[kind == 7] = 1
    opacity[kind == 8] = np.float32(1 / 255)
    sigma[kind == 9] = 0.001
    sigma[kind == 10] = 12
    corners[kind == 11, 0, 2] = -3.0
    tri = np.arange(3 * count, dtype=np.int32).reshape(count, 3)
    shared = rng.random(count) < 0.33
    tri[shared, 0] = rng.integers(0, 3 * count, shared.sum())
    features = rng.uniform(-1, 1, (count, channels)).astype(np.float32)
    return Soup(*map(torch.from_numpy, (corners.reshape(-1, 3), tri, features, opacity, sigma)))
