"""Videos: their containers, the index of their frames, and reading of frames by number."""
