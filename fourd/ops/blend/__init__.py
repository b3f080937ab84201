"""Logits of source views: ``csrc/blend``."""
