"""Texture atlases whose colours are computed from source views."""
