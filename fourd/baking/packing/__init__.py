"""Writing of packed scenes: quantised and compressed frames, each of which decodes alone."""
