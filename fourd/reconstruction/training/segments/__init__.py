"""Runs with segments. Each segment is a range of frames with its own model, so that memory use does not grow with the
length of the capture."""
