"""Editing of baked scenes: frames, regions, floaters, colours, placement and background."""
