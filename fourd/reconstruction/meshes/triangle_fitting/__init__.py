"""Fits a mesh to one frame of a capture by triangle splatting: soft triangles are fitted and gradually become opaque,
and are then joined into a mesh, which is refined."""
