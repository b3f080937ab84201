"""Timings of kernels and training steps, compared with reference implementations and other installed libraries."""
