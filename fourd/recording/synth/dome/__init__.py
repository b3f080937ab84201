"""Synthetic captures of a dome: cameras in the walls of a room, with dark bodies, and two people inside.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fourd.recording.synth.dome.generate import DomeSettings, is_finished, make_dome, suggested_test_views

_MODULES: dict[str, str] = {
    "DomeSettings": "generate",
    "is_finished": "generate",
    "make_dome": "generate",
    "suggested_test_views": "generate",
}
"""Maps each public name to the module of this package that defines it."""

__all__ = ["DomeSettings", "is_finished", "make_dome", "suggested_test_views"]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
