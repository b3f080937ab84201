"""Gaussian splats in GLB files, with the glTF 2.0 extension KHR_gaussian_splatting.

Programs that do not support the extension show coloured points.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.formats.glb import ARRAY_BUFFER, float_accessor, srgb_to_linear, write_parts
from fourd.scene.splats.cloud import SplatCloud

EXTENSION = "KHR_gaussian_splatting"
POINTS = 0


def write_splat_glb(path: Path, cloud: SplatCloud) -> None:
    """Write a cloud of splats, atomically. The cloud must have +y up, as glTF requires.

    Raises UserError if the file would be larger than 4 GiB.
    """
    columns = _columns(cloud)
    document = {
        "asset": {"version": "2.0", "generator": "fourd export"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [_primitive(list(columns))]}],
        "accessors": [
            float_accessor(index, array, has_limits=name == "POSITION")
            for index, (name, array) in enumerate(columns.items())
        ],
    }
    parts = [np.ascontiguousarray(array, "<f4").tobytes() for array in columns.values()]
    write_parts(path, document, parts, [ARRAY_BUFFER] * len(parts))


def _columns(cloud: SplatCloud) -> dict[str, NDArray[np.float32]]:
    """Return the attributes of the glTF primitive by name."""
    linear = srgb_to_linear(cloud.base_colour).astype(np.float32)
    columns = {
        "POSITION": cloud.xyz,
        "COLOR_0": np.concatenate([linear, cloud.opacity[:, None]], axis=1),
        f"{EXTENSION}:ROTATION": cloud.rotation[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": cloud.scale,
        f"{EXTENSION}:OPACITY": cloud.opacity[:, None],
    }
    for degree in range(cloud.degree + 1):
        for index in range(2 * degree + 1):
            columns[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{index}"] = cloud.sh[..., degree**2 + index]
    return columns


def _primitive(names: list[str]) -> dict[str, Any]:
    described = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    attributes = {name: index for index, name in enumerate(names)}
    return {"attributes": attributes, "mode": POINTS, "extensions": {EXTENSION: described}}
