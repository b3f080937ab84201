"""Solid subjects: what stands inside a room, found by multi-view stereo at a few moments of the recording."""
