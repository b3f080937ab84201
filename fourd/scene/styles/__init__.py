"""Draws scenes as cartoons or drawings: styles, presets and point normals. This package does not need torch.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
    from fourd.scene.styles.normals import decode_octahedral, encode_octahedral, estimate_normals
    from fourd.scene.styles.presets import PRESETS, load_style, without_paper
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
    "without_paper",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "PRESETS": "presets",
        "Style": "styles",
        "decode_octahedral": "normals",
        "encode_octahedral": "normals",
        "estimate_normals": "normals",
        "load_style": "presets",
        "view_style": "view",
        "without_paper": "presets",
    },
)
