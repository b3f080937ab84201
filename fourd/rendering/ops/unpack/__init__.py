"""Decoding of packed scenes."""
