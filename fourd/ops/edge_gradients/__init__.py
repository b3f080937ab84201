"""Gradients of moving visibility edges (``csrc/edge_gradients``). The forward pass leaves the image unchanged."""
