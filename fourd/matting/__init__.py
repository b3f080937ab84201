"""Masks and clean background plates from video."""
