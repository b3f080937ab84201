"""Checks that a packed cloud differs from its source only by rounding errors of the encoding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.scene.files.encoding import MAX_CODE, SH_NUMBERS, CloudEncoding
from fourd.scene.packed.members import LARGEST_WEIGHT, ColourRounding, decode_cloud
from fourd.scene.packed.streams import stored
from fourd.scene.scene import BakedFrame

HALF_PRECISION = 2.0**-11
"""Maximum relative rounding error of a float16."""


@dataclass(frozen=True)
class ColourErrors:
    """Accumulates the squared errors of the colours in the source views: their weighted sum, and the sum of the
    weights.

    The weight of a point in a view is its blend weight in this view, divided by its largest blend weight in any view.
    """

    squares: float = 0.0
    weight: float = 0.0

    def __add__(self, other: ColourErrors) -> ColourErrors:
        return ColourErrors(self.squares + other.squares, self.weight + other.weight)

    @property
    def psnr(self) -> float:
        """PSNR of the colours in dB."""
        return float(10 * np.log10(255**2 * max(self.weight, 1e-9) / max(self.squares, 1e-9)))


def check_bounds(
    cloud: BakedFrame,
    members: Mapping[str, bytes],
    encoding: CloudEncoding,
    rounding: ColourRounding,
    cameras: Sequence[Camera],
) -> ColourErrors:
    """Decode ``members`` and compare the result with ``cloud``, whose points are in the same order.

    ``cameras`` are the cameras of the source views. Returns the errors of the colours. They have no bound if the
    colours are stored as images, because image compression is lossy.

    Raises:
        RuntimeError: if an error exceeds the bound that follows from the encoding's quantisation steps. The error
            message names the attribute.
    """
    compressed = {name: stored(content) for name, content in members.items()}
    decoded = decode_cloud(compressed, cloud.point_count, cameras, encoding)
    if cloud.point_count == 0:
        return ColourErrors()
    span = float(np.abs(cloud.xyz).max())
    _check("xyz", np.abs(decoded["xyz"] - cloud.xyz), 0.5001 * encoding.position_step + 2e-7 * span)
    radius = cloud.radius.astype(np.float64)
    factor = 2 ** (0.5001 / encoding.radius_steps) - 1 + 2 * HALF_PRECISION
    # The summand 1e-7 allows for subnormal float16 numbers, whose relative error is larger than HALF_PRECISION.
    _check("radius", np.abs(decoded["radius"] - radius), factor * radius + 1e-7)
    density = np.abs(decoded["density"] - cloud.density.astype(np.float64))
    _check("density", density, 0.5001 / encoding.density_levels + HALF_PRECISION)
    _check_sh(decoded["sh"], cloud.sh, encoding)
    return _check_views(decoded["blend_weights"], decoded["rgb"], cloud, encoding, rounding)


def _check_sh(decoded: NDArray[np.float16], sh: NDArray[np.float16], encoding: CloudEncoding) -> None:
    """Check the root mean square error of the spherical-harmonics coefficients. Errors of single points are not
    checked, because they can be larger: the basis was computed from a sample of the points."""
    difference = decoded.astype(np.float32) - sh.astype(np.float32)
    rms = np.sqrt(np.square(difference).sum(axis=(1, 2)).mean() / SH_NUMBERS)
    magnitude = np.abs(sh.astype(np.float32)).max(initial=0)
    _check("sh", rms, 0.5 * encoding.sh_step + HALF_PRECISION * magnitude)


def _check_views(
    weights: NDArray[np.float16],
    rgb: NDArray[np.uint8],
    cloud: BakedFrame,
    encoding: CloudEncoding,
    rounding: ColourRounding,
) -> ColourErrors:
    if cloud.view_count == 0:
        return ColourErrors()
    true = cloud.blend_weights.astype(np.float64)
    seen = true > 0
    if not np.array_equal(seen, weights > 0):
        raise RuntimeError(
            "blend_weights: expected zeros in the same elements as in the source, got zeros in other elements"
        )
    largest = np.where(seen.any(axis=1), true.max(axis=1), 1)[:, None]
    octaves = np.log2(largest / np.where(seen, true, 1))
    decoded_octaves = np.log2(LARGEST_WEIGHT / np.where(seen, weights.astype(np.float64), 1))
    in_range = seen & (octaves < min((MAX_CODE - 2) / encoding.weight_steps, 20))
    _check("blend_weights", np.abs(decoded_octaves - octaves)[in_range], 0.5001 / encoding.weight_steps + 0.03)
    difference = np.abs(rgb.astype(np.int16) - cloud.rgb.astype(np.int16))
    if encoding.image_scale is None:
        _check("rgb", difference[seen], encoding.colour_step // 2)
    if encoding.every_point_has_colours:
        _check("rgb in unseen views", difference[~seen], rounding.unseen_step // 2)
    shares = true / largest
    squares = np.square(difference.astype(np.float32)).mean(axis=2)
    return ColourErrors(float((squares * shares).sum()), float(shares.sum()))


def _check(name: str, errors: NDArray[np.floating] | np.floating, bound: NDArray[np.floating] | float) -> None:
    if not np.all(errors <= bound):
        raise RuntimeError(f"{name}: expected errors of at most {np.max(bound):.3g}, got {np.max(errors):.3g}")
