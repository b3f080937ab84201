"""Gaussian splats in GLB files, by the extension KHR_gaussian_splatting of glTF 2.0.

Programs without the extension show coloured points.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.baking.splats.cloud import SplatCloud
from fourd.files import atomic_path
from fourd.formats.glb import ARRAY_BUFFER, FLOAT, pad, write_header

EXTENSION = "KHR_gaussian_splatting"
POINTS = 0
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def write_splat_glb(path: Path, cloud: SplatCloud) -> None:
    """Write a cloud, atomically. The cloud has +y up, as glTF demands.

    Raises UserError if the file would be larger than 4 GiB.
    """
    columns = _columns(cloud)
    parts = [np.ascontiguousarray(array, "<f4") for array in columns.values()]
    offsets = np.cumsum([0, *(part.nbytes for part in parts)])
    document = {
        "asset": {"version": "2.0", "generator": "fourd export"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [_primitive(list(columns))]}],
        "accessors": [
            _accessor(index, part, name) for index, (name, part) in enumerate(zip(columns, parts, strict=True))
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": int(offset), "byteLength": part.nbytes, "target": ARRAY_BUFFER}
            for offset, part in zip(offsets, parts, strict=False)
        ],
        "buffers": [{"byteLength": int(offsets[-1])}],
    }
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        write_header(stream, document, int(offsets[-1]), str(path))
        for part in parts:
            stream.write(pad(part.tobytes(), b"\0"))


def _columns(cloud: SplatCloud) -> dict[str, NDArray[np.float32]]:
    """The attributes of the primitive by name."""
    colour = cloud.base_colour
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
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


def _accessor(index: int, part: NDArray[np.float32], name: str) -> dict[str, Any]:
    accessor = {"bufferView": index, "componentType": FLOAT, "count": len(part), "type": TYPES[part.shape[1]]}
    if name == "POSITION" and len(part):
        accessor["min"] = [float(value) for value in part.min(axis=0)]
        accessor["max"] = [float(value) for value in part.max(axis=0)]
    return accessor
