"""Conversion of SceneEncoding to and from the JSON of a manifest. The parser treats the JSON as untrusted."""

from __future__ import annotations

import reprlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fourd.base.json_file import decode_json
from fourd.scene.files.encoding import CloudEncoding, SceneEncoding


@dataclass(frozen=True)
class _Packed:
    encoding: SceneEncoding


def encoding_to_json(encoding: SceneEncoding) -> dict[str, Any]:
    """Return the encoding as JSON values."""
    background = {} if encoding.background is None else {"background": _cloud_to_json(encoding.background)}
    return {"tier": encoding.tier, "dynamic": _cloud_to_json(encoding.dynamic), **background}


def encoding_from_json(manifest: dict[str, Any], *, has_background: bool) -> SceneEncoding:
    """Parse and check the encoding in the JSON of a manifest. Raises ValueError."""
    encoding = decode_json(manifest, _Packed).encoding
    if not has_background:
        encoding = replace(encoding, background=None)
    elif encoding.background is None:
        raise ValueError('encoding: expected a key "background", got none')
    for name, cloud in (("dynamic", encoding.dynamic), ("background", encoding.background)):
        rows = None if cloud is None else manifest["encoding"][name].get("sh_rows")
        if cloud is not None and rows != len(cloud.sh_basis):
            raise ValueError(f"encoding, {name}, sh_rows: expected {len(cloud.sh_basis)}, got {reprlib.repr(rows)}")
    return encoding


def _cloud_to_json(cloud: CloudEncoding) -> dict[str, Any]:
    return {
        "lower": cloud.lower.tolist(),
        "position_step": cloud.position_step,
        "position_bits": cloud.position_bits,
        "radius_lower": cloud.radius_lower,
        "radius_steps": cloud.radius_steps,
        "density_levels": cloud.density_levels,
        "sh_rows": len(cloud.sh_basis),
        "sh_basis": _floats(cloud.sh_basis),
        "sh_mean": _floats(cloud.sh_mean),
        "sh_step": cloud.sh_step,
        "weight_steps": cloud.weight_steps,
        "colour_step": cloud.colour_step,
        "every_point_has_colours": cloud.every_point_has_colours,
        **({} if cloud.image_scale is None else {"image_scale": cloud.image_scale}),
    }


def _floats(values: np.ndarray[Any, np.dtype[np.float32]]) -> list[float]:
    """Return the shortest decimal numbers that parse to the same float32 values."""
    return [float(str(value)) for value in values.ravel()]
