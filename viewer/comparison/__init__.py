"""Compares a scene with the captured pictures from which it was made."""
