"""Draws scenes as cartoons or drawings: styles, presets and point normals. This package does not need torch."""

from fourd.scene.styles.normals import decode_octahedral, encode_octahedral, estimate_normals
from fourd.scene.styles.presets import PRESETS, load_style
from fourd.scene.styles.styles import Style
from fourd.scene.styles.view import view_style

__all__ = [
    "PRESETS",
    "Style",
    "decode_octahedral",
    "encode_octahedral",
    "estimate_normals",
    "load_style",
    "view_style",
]
