"""Blend logits of source views (``csrc/blend``)."""
