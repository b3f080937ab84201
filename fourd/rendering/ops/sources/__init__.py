"""Bilinear sampling of source views at projected points (``csrc/sources``)."""
