"""Fits a mesh to one frame of a capture by triangle splatting. Soft triangles become opaque, are connected to a mesh,
and the mesh is refined."""
