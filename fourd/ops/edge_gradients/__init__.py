"""Gradients of moving visibility edges, computed without changing the image (``csrc/edge_gradients``)."""
