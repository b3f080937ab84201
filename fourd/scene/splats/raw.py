"""Gaussian splats in `.splat` files: 32 bytes per splat, without spherical harmonics above degree 0."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fourd.base.errors import UserError
from fourd.base.files import atomic_path
from fourd.base.limits import read_limited
from fourd.rendering.ops.shade.harmonics import SH_CONSTANT
from fourd.scene.splats.cloud import SplatCloud, make_valid_cloud

ROW = np.dtype([("xyz", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])


def write_splat(path: Path, cloud: SplatCloud) -> None:
    """Write a cloud, atomically. Large and opaque splats are written first, so that a viewer can draw a useful image
    while the file loads."""
    rows = np.zeros(len(cloud), ROW)
    rows["xyz"], rows["scale"] = cloud.xyz, cloud.scale
    rgba = np.concatenate([cloud.base_colour, cloud.opacity[:, None]], axis=1)
    rows["rgba"] = np.rint(np.clip(rgba, 0, 1) * 255)
    rows["rotation"] = np.clip(np.rint(cloud.rotation * 128 + 128), 0, 255)
    order = np.argsort(-cloud.opacity * cloud.scale.prod(axis=1), kind="stable")
    with atomic_path(path) as temporary:
        temporary.write_bytes(rows[order].tobytes())


def count_splats(path: Path) -> int:
    """Return the number of splats in the file. Raises UserError if its size is not a multiple of 32 bytes."""
    try:
        size = path.stat().st_size
    except OSError as error:
        raise UserError(f"{path}: expected a readable .splat file, got {error.strerror}; check the path") from error
    if size % ROW.itemsize:
        raise UserError(f"{path}: expected a multiple of 32 bytes, got {size} bytes; write the .splat file again")
    return size // ROW.itemsize


def read_splat(path: Path) -> SplatCloud:
    """Read a cloud. Splats with invalid values are left out, see :func:`fourd.scene.splats.cloud.make_valid_cloud`.

    Raises:
        UserError: if the file cannot be read, or its size is not a multiple of 32 bytes.
    """
    count = count_splats(path)
    rows = np.frombuffer(read_limited(path, count * ROW.itemsize), ROW, count=count)
    rgba = np.asarray(rows["rgba"] / 255, np.float32)
    return make_valid_cloud(
        rows["xyz"].astype(np.float32),
        rows["scale"].astype(np.float32),
        np.asarray(rows["rotation"] / 128 - 1, np.float32),
        rgba[:, 3],
        np.asarray((rgba[:, :3] - 0.5) / SH_CONSTANT, np.float32)[..., None],
    )
