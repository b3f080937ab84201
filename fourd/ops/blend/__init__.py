"""Blend logits: the logarithms of the weights with which the colours of source views are blended (``csrc/blend``)."""
