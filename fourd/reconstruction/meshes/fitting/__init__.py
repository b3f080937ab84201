"""Fitting of one frame's surface to the mattes and images of its views."""
