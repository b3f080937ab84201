"""Interactive and headless viewing of scenes: renderers, camera paths, playback and the window."""
