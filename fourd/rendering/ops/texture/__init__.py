"""Filtered texture lookup with mip levels (``csrc/texture``)."""
