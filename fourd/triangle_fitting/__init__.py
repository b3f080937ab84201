"""Fits a mesh to one frame of a capture by triangle splatting. First, soft triangles are fitted and gradually become
opaque. Then they are joined into a mesh, and the mesh is refined."""
