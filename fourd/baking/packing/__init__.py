"""Packed scenes (version 3 of the `.4dv`): quantised and compressed frames, each of which decodes alone."""
