"""Captures as a real rig records them, made from clean captures, with the truth beside them.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
    from fourd.recording.synth.rig.generate import make_rig_capture
    from fourd.recording.synth.rig.settings import FACTORS, USUAL, RigSettings, parse_factors

__all__ = ["FACTORS", "USUAL", "RigSettings", "make_rig_capture", "parse_factors"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "FACTORS": "settings",
        "USUAL": "settings",
        "RigSettings": "settings",
        "make_rig_capture": "generate",
        "parse_factors": "settings",
    },
)
