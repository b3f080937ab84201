"""Sampling of source views: ``csrc/sources``."""
