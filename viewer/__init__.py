"""Seeing scenes: camera paths and videos."""
