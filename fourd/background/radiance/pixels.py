"""All pixels of all plates that rays are drawn from, with the depths that are known or guessed there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from fourd.background.radiance.rays import Rays, ray_matrix, to_share
from fourd.background.stereo.depth_maps import Small
from fourd.background.stereo.fusion import Surface
from fourd.background.stereo.patches import index_intrinsics

STEEP = 0.5
"""Of a cell's inverse depth: a plane that falls below this within its cell is seen edge on and tells nothing."""


@dataclass(frozen=True, eq=False)
class Batch:
    """R rays and what is known of them.

    Attributes:
        rays: in the world.
        rgb: (R, 3) in [0, 1].
        share: (R,) of the ray, where its surface is; NaN where nothing tells.
        measured: (R,) bool, whether stereo measured it.
    """

    rays: Rays
    rgb: Tensor
    share: Tensor
    measured: Tensor


@dataclass(frozen=True, eq=False)
class Pixels:
    """P pixels of V plates.

    Attributes:
        plate: (P,) int16, which plate.
        xy: (P, 2) int16, column and row.
        rgb: (P, 3) uint8.
        share, measured: (P,) as in :class:`Batch`.
        centres: (V, 3) float32, the cameras' in the world.
        matrices: (V, 3, 3) float32, from (x, y, 1) in pixels to directions in the world.
    """

    plate: Tensor
    xy: Tensor
    rgb: Tensor
    share: Tensor
    measured: Tensor
    centres: Tensor
    matrices: Tensor

    @staticmethod
    def of(smalls: Sequence[Small], known: Sequence[Surface], continued: Sequence[Surface], unit: float) -> Pixels:
        """The pixels that the plates show.

        Args:
            smalls: the plates.
            known: what stereo measured of each.
            continued: the same with guesses beside it.
            unit: of distances along rays, in world units.
        """
        parts = [_pixels(*each, unit) for each in zip(smalls, known, continued, strict=True)]
        plate = torch.repeat_interleave(torch.tensor([len(part.xy) for part in parts]))
        centres = np.stack([small.camera.centre for small in smalls])
        matrices = np.stack([ray_matrix(small.camera) for small in smalls])
        return Pixels(
            plate.short(),
            torch.from_numpy(np.concatenate([part.xy for part in parts])),
            torch.from_numpy(np.concatenate([part.rgb for part in parts])),
            torch.from_numpy(np.concatenate([part.share for part in parts])),
            torch.from_numpy(np.concatenate([part.measured for part in parts])),
            torch.from_numpy(centres).float(),
            torch.from_numpy(matrices).float(),
        )

    def draw(self, count: int, generator: torch.Generator) -> Batch:
        """Random ones of them, any of which may come twice."""
        chosen = torch.randint(len(self.xy), (count,), generator=generator)
        plate = self.plate[chosen].long()
        places = functional.pad(self.xy[chosen].float() + 0.5, (0, 1), value=1.0)
        directions = functional.normalize((self.matrices[plate] @ places[..., None])[..., 0], dim=1)
        rays = Rays(self.centres[plate], directions)
        return Batch(rays, self.rgb[chosen].float() / 255, self.share[chosen], self.measured[chosen])


@dataclass(frozen=True, eq=False)
class _Part:
    """One plate's pixels."""

    xy: NDArray[np.int16]
    rgb: NDArray[np.uint8]
    share: NDArray[np.float32]
    measured: NDArray[np.bool_]


def _pixels(small: Small, known: Surface, continued: Surface, unit: float) -> _Part:
    rows, columns = np.nonzero(small.seen)
    xy = np.column_stack([columns, rows])
    cells = continued.depths.grid.cells_at(xy.astype(np.float64))
    homogeneous = np.column_stack([xy, np.ones(len(xy))])
    inverse = (continued.depths.planes[cells] * homogeneous).sum(axis=1)
    sound = (cells >= 0) & continued.known[cells] & (inverse > STEEP * continued.depths.inverse_depth[cells])
    lengths = np.linalg.norm(homogeneous @ np.linalg.inv(index_intrinsics(small.camera)).T, axis=1)
    distance = np.where(sound, lengths / np.where(sound, inverse, 1) / unit, np.nan)
    share = np.where(sound, to_share(torch.from_numpy(distance).nan_to_num()).numpy(), np.nan)
    measured = sound & known.known[cells]
    return _Part(xy.astype(np.int16), small.rgb[rows, columns], share.astype(np.float32), measured)
