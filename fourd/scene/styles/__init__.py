"""Draws scenes as cartoons or drawings: styles, presets and point normals. This package does not need torch.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fourd.scene.styles.normals import decode_octahedral, encode_octahedral, estimate_normals
    from fourd.scene.styles.presets import PRESETS, load_style
    from fourd.scene.styles.styles import Style
    from fourd.scene.styles.view import view_style

_MODULES: dict[str, str] = {
    "PRESETS": "presets",
    "Style": "styles",
    "decode_octahedral": "normals",
    "encode_octahedral": "normals",
    "estimate_normals": "normals",
    "load_style": "presets",
    "view_style": "view",
}
"""Maps each public name to the module of this package that defines it."""

__all__ = ["PRESETS", "Style", "decode_octahedral", "encode_octahedral", "estimate_normals", "load_style", "view_style"]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
