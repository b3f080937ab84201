"""Differentiable compositing of points (``csrc/points``)."""
