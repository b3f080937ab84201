"""Measures distances between points of a scene."""
