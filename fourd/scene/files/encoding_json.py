"""Conversion of SceneEncoding to and from the JSON of a manifest. The parser treats the JSON as untrusted."""

from __future__ import annotations

from typing import Any

import numpy as np

from fourd.rendering.ops.morton import MAX_BITS
from fourd.scene.files.encoding import (
    MAX_CODE,
    MAX_COLOUR_STEP,
    SH_NUMBERS,
    TIERS,
    CloudEncoding,
    SceneEncoding,
)
from fourd.scene.files.json_node import JsonNode

MAX_STEPS = 1 << 16
"""Maximum number of codes for each doubling of a radius or of a weight."""
MIN_IMAGE_SCALE = 1 / 64


def encoding_to_json(encoding: SceneEncoding) -> dict[str, Any]:
    """Return the encoding as JSON values."""
    background = {} if encoding.background is None else {"background": _cloud_to_json(encoding.background)}
    return {"tier": encoding.tier, "dynamic": _cloud_to_json(encoding.dynamic), **background}


def encoding_from_json(node: JsonNode, *, has_background: bool) -> SceneEncoding:
    """Parse and check an encoding. Raises ManifestError."""
    background = _cloud_from_json(node.node("background")) if has_background else None
    return SceneEncoding(node.choice("tier", TIERS), _cloud_from_json(node.node("dynamic")), background)


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


def _cloud_from_json(node: JsonNode) -> CloudEncoding:
    rows = node.integer("sh_rows", 0, SH_NUMBERS)
    return CloudEncoding(
        lower=node.array("lower", (3,)),
        position_step=node.number("position_step", 1e-30, 1e30),
        position_bits=node.integer("position_bits", 1, MAX_BITS),
        radius_lower=node.number("radius_lower", 1e-30, 1e4),
        radius_steps=node.integer("radius_steps", 1, MAX_STEPS),
        density_levels=node.integer("density_levels", 1, MAX_CODE),
        sh_basis=node.array("sh_basis", (rows, SH_NUMBERS)).astype(np.float32),
        sh_mean=node.array("sh_mean", (SH_NUMBERS,)).astype(np.float32),
        sh_step=node.number("sh_step", 1e-9, 1e3),
        weight_steps=node.integer("weight_steps", 1, MAX_STEPS),
        colour_step=node.integer("colour_step", 1, MAX_COLOUR_STEP),
        every_point_has_colours=node.flag("every_point_has_colours"),
        image_scale=node.number("image_scale", MIN_IMAGE_SCALE, 1) if "image_scale" in node.content else None,
    )


def _floats(values: np.ndarray[Any, np.dtype[np.float32]]) -> list[float]:
    """Return the shortest decimal numbers that parse to the same float32 values."""
    return [float(str(value)) for value in values.ravel()]
