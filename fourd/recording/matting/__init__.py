"""Mattes and clean plates from video."""
