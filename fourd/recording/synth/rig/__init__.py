"""Captures as a real rig records them, made from clean captures, with the truth beside them.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fourd.recording.synth.rig.generate import make_rig_capture
    from fourd.recording.synth.rig.settings import FACTORS, USUAL, RigSettings, parse_factors

_MODULES: dict[str, str] = {
    "FACTORS": "settings",
    "USUAL": "settings",
    "RigSettings": "settings",
    "make_rig_capture": "generate",
    "parse_factors": "settings",
}
"""Maps each public name to the module of this package that defines it."""

__all__ = ["FACTORS", "USUAL", "RigSettings", "make_rig_capture", "parse_factors"]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
