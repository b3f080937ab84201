"""Texture atlases, and computation of their colours from source views."""
