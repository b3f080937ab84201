"""Antialiasing of silhouette edges (``csrc/antialias``)."""
