"""The training pixels of all plates, with measured or extrapolated depths.

In this module, a cell is one sample of a plate's depth map. Each cell covers several pixels and stores a plane in
space, which gives the depth at each of these pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from fourd.reconstruction.background.radiance.rays import RayRange, Rays, ray_matrix
from fourd.recording.stereo.depth_maps import ReducedPlate
from fourd.recording.stereo.fusion import Surface
from fourd.recording.stereo.patches import index_intrinsics

MIN_INVERSE_RATIO = 0.5
"""Minimum ratio of the inverse depth at a pixel to the inverse depth at the centre of its cell. If the ratio is lower,
the pixel's depth is not used. Such low ratios occur if the cell's plane is seen almost edge-on."""


@dataclass(frozen=True, eq=False)
class Batch:
    """R rays with their colours and depths.

    Attributes:
        rays: the rays in world coordinates.
        rgb: (R, 3) colours in [0, 1].
        surface: (R,) normalised distance of the surface along the ray, or NaN if the distance is unknown.
        measured: (R,) bool, true if stereo measured the distance.
    """

    rays: Rays
    rgb: Tensor
    surface: Tensor
    measured: Tensor


@dataclass(frozen=True, eq=False)
class Pixels:
    """P pixels of V plates.

    Attributes:
        plate: (P,) int16 index of each pixel's plate.
        xy: (P, 2) int16 column and row of each pixel.
        rgb: (P, 3) uint8 colours.
        surface: (P,) normalised distance of the surface along the ray, or NaN if the distance is unknown.
        measured: (P,) bool, true if stereo measured the distance.
        centres: (V, 3) float32 camera centres in world coordinates.
        matrices: (V, 3, 3) float32 matrices that map pixels (x, y, 1) to ray directions in world coordinates.
        span: range of the rays, which normalises the distances of ``surface``.
    """

    plate: Tensor
    xy: Tensor
    rgb: Tensor
    surface: Tensor
    measured: Tensor
    centres: Tensor
    matrices: Tensor
    span: RayRange

    @staticmethod
    def from_plates(
        plates: Sequence[ReducedPlate],
        measured: Sequence[Surface],
        continued: Sequence[Surface],
        unit: float,
        span: RayRange,
    ) -> Pixels:
        """Collect the visible pixels of all plates.

        Args:
            plates: the plates at the size used for stereo.
            measured: surfaces from stereo, one per plate.
            continued: the same surfaces with extrapolated depths in unknown cells.
            unit: radius of the field's space contraction in world units. Distances along rays are in multiples of this
                radius.
            span: range of the rays.
        """
        parts = [_plate_pixels(*each, unit, span) for each in zip(plates, measured, continued, strict=True)]
        plate = torch.repeat_interleave(torch.tensor([len(part.xy) for part in parts]))
        centres = np.stack([each.camera.centre for each in plates])
        matrices = np.stack([ray_matrix(each.camera) for each in plates])
        return Pixels(
            plate.short(),
            torch.from_numpy(np.concatenate([part.xy for part in parts])),
            torch.from_numpy(np.concatenate([part.rgb for part in parts])),
            torch.from_numpy(np.concatenate([part.surface for part in parts])),
            torch.from_numpy(np.concatenate([part.measured for part in parts])),
            torch.from_numpy(centres).float(),
            torch.from_numpy(matrices).float(),
            span,
        )

    def sample(self, count: int, generator: torch.Generator) -> Batch:
        """Sample ``count`` random pixels with replacement."""
        chosen = torch.randint(len(self.xy), (count,), generator=generator)
        plate = self.plate[chosen].long()
        pixels = functional.pad(self.xy[chosen].float() + 0.5, (0, 1), value=1.0)
        directions = functional.normalize((self.matrices[plate] @ pixels[..., None])[..., 0], dim=1)
        rays = Rays(self.centres[plate], directions)
        return Batch(rays, self.rgb[chosen].float() / 255, self.surface[chosen], self.measured[chosen])


@dataclass(frozen=True, eq=False)
class _Part:
    """The pixels of one plate."""

    xy: NDArray[np.int16]
    rgb: NDArray[np.uint8]
    surface: NDArray[np.float32]
    measured: NDArray[np.bool_]


def _plate_pixels(reduced: ReducedPlate, measured: Surface, continued: Surface, unit: float, span: RayRange) -> _Part:
    rows, columns = np.nonzero(reduced.seen)
    xy = np.column_stack([columns, rows])
    cells = continued.depths.grid.cells_at(xy.astype(np.float64))
    homogeneous = np.column_stack([xy, np.ones(len(xy))])
    inverse = (continued.depths.planes[cells] * homogeneous).sum(axis=1)
    valid = (
        (cells >= 0) & continued.known[cells] & (inverse > MIN_INVERSE_RATIO * continued.depths.inverse_depth[cells])
    )
    lengths = np.linalg.norm(homogeneous @ np.linalg.inv(index_intrinsics(reduced.camera)).T, axis=1)
    distance = np.where(valid, lengths / np.where(valid, inverse, 1) / unit, np.nan)
    surface = np.where(valid, span.to_normalized(torch.from_numpy(distance).nan_to_num()).numpy(), np.nan)
    is_measured = valid & measured.known[cells]
    return _Part(xy.astype(np.int16), reduced.rgb[rows, columns], surface.astype(np.float32), is_measured)
