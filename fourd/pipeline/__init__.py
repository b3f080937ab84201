"""Stages from videos or a capture to a scene, the graph that orders them, and the runner that caches them."""
