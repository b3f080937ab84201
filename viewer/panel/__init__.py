"""The viewer's panel. Each section has its own file, and panel.py lists the sections."""
