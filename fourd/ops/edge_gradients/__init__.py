"""Gradients of moving visibility edges, without a change of the image (``csrc/edge_gradients``)."""
