"""Shadows of the subject on the floor, found because all cameras see the floor darkened by the same factor."""
