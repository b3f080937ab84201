"""Fits a mesh to one frame of a capture by triangle splatting: soft triangles harden, are connected and refined."""
