"""Scenes and runs in notebooks: a widget that plays them, which reads the scene over the connection of the kernel."""
