"""Structural similarity with its gradient: ``csrc/similarity``."""
