"""Blend logits: the logarithms of the weights with which source views' colours are blended (``csrc/blend``)."""
