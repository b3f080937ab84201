"""Viewer poses, camera paths and saved views."""
