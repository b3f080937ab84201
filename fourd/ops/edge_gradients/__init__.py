"""Gradients at visibility edges that do not change the image (``csrc/edge_gradients``)."""
