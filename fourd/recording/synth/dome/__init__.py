"""Synthetic captures of a dome: cameras in the walls of a room, with dark bodies, and two people inside."""

from fourd.recording.synth.dome.generate import DomeSettings, is_finished, make_dome, suggested_test_views

__all__ = ["DomeSettings", "is_finished", "make_dome", "suggested_test_views"]
