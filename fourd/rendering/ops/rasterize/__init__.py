"""Rasterization of triangles (``csrc/rasterize``)."""
