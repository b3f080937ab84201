"""Gaussian splats in SPZ files (Niantic), written with the package gsply. SPZ files have +y up."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np

from fourd.base.errors import UserError
from fourd.base.files import atomic_path
from fourd.scene.splats.cloud import SMALLEST_SCALE, SplatCloud
from fourd.scene.splats.ply import OPACITY_MARGIN

POSITION_BITS = 24
MAX_FRACTIONAL_BITS = 16


def require_gsply(path: Path) -> Any:
    """Import the package gsply. Raises UserError if the package is not installed."""
    if importlib.util.find_spec("gsply") is None:
        raise UserError(
            f"{path}: SPZ files need the package gsply, which is not installed; pip install 'fourd[splats]'"
        )
    import gsply

    return gsply


def write_spz(path: Path, cloud: SplatCloud) -> None:
    """Write a cloud as SPZ version 3, atomically. Raises UserError if the package gsply is not installed."""
    gsply = require_gsply(path)
    opacity = np.clip(cloud.opacity.astype(np.float64), OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    data = gsply.GSData(
        means=cloud.xyz,
        scales=np.log(np.maximum(cloud.scale, SMALLEST_SCALE)),
        quats=cloud.rotation,
        opacities=np.log(opacity / (1 - opacity)).astype(np.float32),
        sh0=np.ascontiguousarray(cloud.sh[..., 0]),
        shN=np.ascontiguousarray(cloud.sh[..., 1:].transpose(0, 2, 1)),
    )
    with atomic_path(path) as temporary:
        gsply.write_spz(temporary, data, version=3, fractional_bits=_fractional_bits(cloud))


def _fractional_bits(cloud: SplatCloud) -> int:
    """Return the number of fractional bits of the fixed-point coordinates: at most MAX_FRACTIONAL_BITS, and few enough
    that all coordinates fit in POSITION_BITS bits."""
    farthest = float(np.abs(cloud.xyz).max(initial=1e-3))
    whole = max(int(np.ceil(np.log2(farthest * 1.001))), 0) + 1
    return min(max(POSITION_BITS - 1 - whole, 0), MAX_FRACTIONAL_BITS)
