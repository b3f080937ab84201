"""Rendering of trained scenes, image metrics, and scores of held-out views."""
