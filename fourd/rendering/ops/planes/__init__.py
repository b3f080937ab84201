"""Bilinear sampling of feature planes (``csrc/planes``)."""
