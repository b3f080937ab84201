"""Differentiable surfaces: tetrahedral grids, marching tetrahedra, mesh losses and remeshing."""
