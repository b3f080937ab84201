"""The viewer's panel. There is one file per section, and panel.py lists the sections."""
