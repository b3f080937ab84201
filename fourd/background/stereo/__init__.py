"""Depth maps of pictures from known cameras, and what they agree on."""
