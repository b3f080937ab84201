"""Captures as a real rig records them, made from clean captures, with the truth beside them."""

from fourd.recording.synth.rig.generate import make_rig_capture
from fourd.recording.synth.rig.settings import FACTORS, USUAL, RigSettings, parse_factors

__all__ = ["FACTORS", "USUAL", "RigSettings", "make_rig_capture", "parse_factors"]
