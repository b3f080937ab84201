"""Gradients of moving visibility edges. The image itself does not change (``csrc/edge_gradients``)."""
