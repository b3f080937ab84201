"""Gradients of moving visibility edges (``csrc/edge_gradients``), which do not change the image in the forward pass."""
