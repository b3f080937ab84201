"""Gradients of a rendered image that arise because visibility edges (silhouettes, and lines where triangles intersect)
move with the vertices (``csrc/edge_gradients``). The forward pass returns the image unchanged."""
