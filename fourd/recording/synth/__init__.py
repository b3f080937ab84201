"""Synthetic captures with ground truth: a running, textured human figure inside a ring of cameras.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
    from fourd.recording.synth.generate import SynthSettings, is_finished, make_synthetic

__all__ = ["SynthSettings", "is_finished", "make_synthetic"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "SynthSettings": "generate",
        "is_finished": "generate",
        "make_synthetic": "generate",
    },
)
