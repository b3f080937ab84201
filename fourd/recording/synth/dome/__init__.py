"""Synthetic captures of a dome: cameras in the walls of a room, with dark bodies, and two people inside.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
    from fourd.recording.synth.dome.generate import DomeSettings, is_finished, make_dome, suggested_test_views

__all__ = ["DomeSettings", "is_finished", "make_dome", "suggested_test_views"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "DomeSettings": "generate",
        "is_finished": "generate",
        "make_dome": "generate",
        "suggested_test_views": "generate",
    },
)
