"""Synthetic captures with ground truth: an articulated, textured figure that runs inside a ring of cameras."""

from fourd.synth.generate import SynthSettings, is_finished, make_synthetic

__all__ = ["SynthSettings", "is_finished", "make_synthetic"]
