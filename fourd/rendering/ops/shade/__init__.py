"""Colours of baked points for a viewpoint (``csrc/shade``)."""
