"""Bilinear samples of feature planes (``csrc/planes``)."""
