"""Interpolation of vertex attributes over triangles (``csrc/interpolate``)."""
