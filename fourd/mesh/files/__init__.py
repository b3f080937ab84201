"""Mesh files: GLB with textures and animation, and PLY."""
