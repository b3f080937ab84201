"""Differentiable triangle splatting (``csrc/splat_triangles``)."""
