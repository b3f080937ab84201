"""Gaussian splats in PLY files, with the properties of 3D Gaussian Splatting (Kerbl et al. 2023).

Scales are stored as logarithms, opacities as logits, and rotations as quaternions (w, x, y, z). The spherical-harmonics
coefficients above degree 0 are stored channel by channel.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.formats.ply import read_header, read_vertices, write_vertices
from fourd.scene.splats.cloud import SMALLEST_SCALE, TERMS_BY_DEGREE, SplatCloud, make_valid_cloud

OPACITY_MARGIN = 1e-6
MAX_LOGARITHM = 60.0
REQUIRED = (
    *("x", "y", "z", "opacity"),
    *(f"scale_{axis}" for axis in range(3)),
    *(f"rot_{axis}" for axis in range(4)),
    *(f"f_dc_{channel}" for channel in range(3)),
)
"""Properties that a PLY file of splats must have."""


def write_splat_ply(path: Path, cloud: SplatCloud) -> None:
    """Write a cloud as binary PLY, atomically."""
    rest = 3 * (cloud.sh.shape[-1] - 1)
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{c}" for c in range(3)), *(f"f_rest_{i}" for i in range(rest))]
    names += ["opacity", *(f"scale_{axis}" for axis in range(3)), *(f"rot_{axis}" for axis in range(4))]
    opacity = np.clip(cloud.opacity.astype(np.float64), OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    columns: list[NDArray[Any]] = [
        cloud.xyz,
        np.zeros((len(cloud), 3)),
        cloud.sh[..., 0],
        cloud.sh[..., 1:].reshape(len(cloud), rest),
        np.log(opacity / (1 - opacity))[:, None],
        np.log(np.maximum(cloud.scale, SMALLEST_SCALE)),
        cloud.rotation,
    ]
    table = np.ascontiguousarray(np.concatenate(columns, axis=1), "<f4")
    write_vertices(path, table.view([(name, "<f4") for name in names])[:, 0])


def is_splat_ply(path: Path) -> bool:
    """Return True if a PLY file has the properties of splats. Raises UserError if its header is not valid."""
    return read_header(path).names >= set(REQUIRED)


def read_splat_ply(path: Path) -> SplatCloud:
    """Read a cloud. Splats with invalid values are left out, see :func:`fourd.scene.splats.cloud.make_valid_cloud`.

    Raises:
        UserError: if the file is missing or truncated, or lacks a property that splats need. The message names the
            file.
    """
    rows = read_vertices(path)
    names = set(rows.dtype.names or ())
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise UserError(
            f"{path}: expected the properties of Gaussian splats, got no {missing[0]}; "
            "convert the file to an uncompressed 3DGS PLY, for example with splat-transform"
        )
    rest = sum(name.startswith("f_rest_") for name in names)
    terms = rest // 3 + 1
    if rest % 3 or terms not in TERMS_BY_DEGREE or not all(f"f_rest_{index}" in names for index in range(rest)):
        raise UserError(f"{path}: expected 0, 9, 24 or 45 properties f_rest_N, got {rest}; write the file again")
    higher = _columns(rows, [f"f_rest_{index}" for index in range(rest)]).reshape(len(rows), 3, terms - 1)
    base = _columns(rows, [f"f_dc_{channel}" for channel in range(3)])
    logarithms = np.clip(_columns(rows, [f"scale_{axis}" for axis in range(3)]), -MAX_LOGARITHM, MAX_LOGARITHM)
    logits = np.clip(_columns(rows, ["opacity"])[:, 0], -MAX_LOGARITHM, MAX_LOGARITHM)
    return make_valid_cloud(
        _columns(rows, ["x", "y", "z"]),
        np.exp(logarithms),
        _columns(rows, [f"rot_{axis}" for axis in range(4)]),
        np.asarray(1 / (1 + np.exp(-logits)), np.float32),
        np.concatenate([base[..., None], higher], axis=-1),
    )


def _columns(rows: NDArray[Any], names: list[str]) -> NDArray[np.float32]:
    table = np.empty((len(rows), len(names)), np.float32)
    for index, name in enumerate(names):
        table[:, index] = rows[name]
    return table
