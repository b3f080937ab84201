"""Synthetic captures with ground truth: a running, textured human figure inside a ring of cameras."""

from fourd.recording.synth.generate import SynthSettings, is_finished, make_synthetic

__all__ = ["SynthSettings", "is_finished", "make_synthetic"]
