"""Meshes of frames: marching tetrahedra, mesh losses, fitting to images, texturing and export.

Importing this package does not import torch. Only the modules that need torch import it.
"""
