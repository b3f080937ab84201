"""Where the viewer stands: poses, camera paths, saved views."""
