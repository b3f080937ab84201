"""Chooses the quantisation steps of an encoding from samples of a scene's points."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.morton import MAX_BITS
from fourd.scene.files.encoding import SH_NUMBERS, CloudEncoding
from fourd.scene.packed.colours import has_own_unseen_colours
from fourd.scene.packing.precision import Precision
from fourd.scene.scene import BakedFrame

SAMPLES, SAMPLES_PER_FRAME = 200_000, 2000
"""Maximum number of points, in total and per frame, from which the basis of the spherical-harmonics coefficients is
computed."""

_SMALLEST = 1e-9
"""Basis elements whose absolute value is below this threshold are set to 0, because arithmetic with subnormal numbers
is slow."""


@dataclass(frozen=True, eq=False)
class CloudSamples:
    """Extreme values and samples of the points of a cloud.

    Attributes:
        lower, upper: (3,) float64, smallest and largest coordinates.
        radius_lower: smallest radius above 0, in world units.
        radii: (S,) float32, sampled radii in world units.
        sh: (S, 48) float32, sampled spherical-harmonics coefficients.
        has_own_unseen_colours: see :func:`fourd.scene.packed.colours.has_own_unseen_colours`.
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    radius_lower: float
    radii: NDArray[np.float32]
    sh: NDArray[np.float32]
    has_own_unseen_colours: bool


def merge_samples(samples: Iterable[CloudSamples]) -> CloudSamples:
    """Merge the samples of single frames into the samples of all frames. There must be at least one frame."""
    parts = list(samples)
    return CloudSamples(
        np.min([part.lower for part in parts], axis=0),
        np.max([part.upper for part in parts], axis=0),
        min(part.radius_lower for part in parts),
        np.concatenate([part.radii for part in parts]),
        np.concatenate([part.sh for part in parts]),
        any(part.has_own_unseen_colours for part in parts),
    )


def sample_cloud(frame: BakedFrame, frames: int = 1) -> CloudSamples:
    """Sample the points of one frame at equally spaced indices. ``frames`` is the number of all sampled frames. With
    more frames, fewer points are sampled per frame."""
    if frame.point_count == 0:
        nothing = np.zeros(0, np.float32)
        return CloudSamples(
            np.full(3, np.inf), np.full(3, -np.inf), np.inf, nothing, np.zeros((0, SH_NUMBERS), np.float32), False
        )
    count = max(min(SAMPLES_PER_FRAME, SAMPLES // frames), 1)
    chosen = np.unique(np.linspace(0, frame.point_count - 1, count).astype(np.int64))
    radius = frame.radius.astype(np.float32)
    positive = radius[radius > 0]
    return CloudSamples(
        frame.xyz.min(axis=0).astype(np.float64),
        frame.xyz.max(axis=0).astype(np.float64),
        float(positive.min()) if len(positive) else np.inf,
        radius[chosen],
        frame.sh[chosen].reshape(len(chosen), SH_NUMBERS).astype(np.float32),
        has_own_unseen_colours(frame),
    )


def fit_encoding(samples: CloudSamples, precision: Precision, image_scale: float | None = None) -> CloudEncoding:
    """Return the encoding of a cloud for the quantisation steps in ``precision``.

    ``image_scale`` is the scale of the images of the source views, or None if colours are stored for each point.
    """
    basis, mean = _sh_basis(samples.sh, precision.sh_step)
    radius = float(np.median(samples.radii)) if len(samples.radii) else 0.0
    side = float((samples.upper - samples.lower).max()) if np.isfinite(samples.lower).all() else 0.0
    smallest_step = max(side, 1e-9) / (2**MAX_BITS - 1)
    step = max(radius / precision.positions_per_radius, smallest_step)
    return CloudEncoding(
        lower=samples.lower if np.isfinite(samples.lower).all() else np.zeros(3),
        position_step=step,
        position_bits=min(max(int(np.ceil(np.log2(side / step + 1.5))), 1), MAX_BITS),
        radius_lower=samples.radius_lower if np.isfinite(samples.radius_lower) else 1.0,
        radius_steps=precision.radius_steps,
        density_levels=precision.density_levels,
        sh_basis=basis,
        sh_mean=mean,
        sh_step=precision.sh_step,
        weight_steps=precision.weight_steps,
        colour_step=precision.colour_step,
        every_point_has_colours=precision.unseen_colour_step is not None and samples.has_own_unseen_colours,
        image_scale=image_scale,
    )


def _sh_basis(sh: NDArray[np.float32], step: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the principal components (K, 48) of the coefficients and their mean (48,).

    A factor is the coordinate of a sample along a component. Components whose factors are at most half a quantisation
    step in all samples are left out, because these factors would be rounded to 0.
    """
    if len(sh) == 0:
        return np.zeros((0, SH_NUMBERS), np.float32), np.zeros(SH_NUMBERS, np.float32)
    mean = sh.mean(axis=0)
    _, components = np.linalg.eigh(np.cov((sh - mean).T.astype(np.float64), bias=True))
    basis = components.T[::-1].astype(np.float32)
    basis[np.abs(basis) < _SMALLEST] = 0
    kept = np.abs((sh - mean) @ basis.T).max(axis=0) > step / 2
    return np.ascontiguousarray(basis[kept]), mean
