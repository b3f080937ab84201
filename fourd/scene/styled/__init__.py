"""Drawing of baked frames in a style, on the CPU."""
