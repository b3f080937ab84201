"""Texture atlases, and their colours from source views."""
