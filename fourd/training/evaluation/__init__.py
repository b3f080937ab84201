"""Rendering of trained frames and their scores."""
