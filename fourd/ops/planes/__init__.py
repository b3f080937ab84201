"""Lookups in feature planes: ``csrc/planes``."""
