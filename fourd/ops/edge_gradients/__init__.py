"""Gradients of moving visibility edges (``csrc/edge_gradients``). The forward pass returns the image unchanged."""
