"""Meshes of frames: marching tetrahedra, mesh losses, fitting to images, texturing and export.

Importing this package does not import torch. torch is imported only by the modules that need it.
"""
