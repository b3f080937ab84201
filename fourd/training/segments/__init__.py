"""Runs with segments. Each segment is a range of frames that has its own model, so that memory does not grow with the
length of a capture."""
