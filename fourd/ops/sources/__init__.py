"""Bilinear samples of source views at projected points (``csrc/sources``)."""
