"""Differentiable soft rasterization of triangles (``csrc/soft_triangles``)."""
