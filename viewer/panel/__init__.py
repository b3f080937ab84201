"""The viewer's panel: one file per section, listed in panel.py."""
