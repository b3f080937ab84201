"""Render trained scenes, compute image metrics, and score held-out views."""
