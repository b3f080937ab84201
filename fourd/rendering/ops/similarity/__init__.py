"""Structural similarity as a loss (``csrc/similarity``)."""
