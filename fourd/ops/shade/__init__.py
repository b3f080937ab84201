"""Colours of baked points seen from a camera (``csrc/shade``)."""
