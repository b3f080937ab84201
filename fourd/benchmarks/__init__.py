"""Timings of kernels and stages, compared with their references and with other installed programs."""
