"""Completion of depth maps where stereo finds no match, and sampling of points on their surfaces."""
