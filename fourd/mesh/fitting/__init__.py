"""Fitting of the surface of one frame to the mattes and images of its views."""
