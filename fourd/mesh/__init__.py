"""Meshes of frames: marching tetrahedra, mesh losses, fitting to images, texturing and export.

torch is loaded by the modules that need it, not when this package is imported.
"""
