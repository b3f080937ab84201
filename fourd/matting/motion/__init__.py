"""Mattes without network weights: foreground and background models learned from motion and from the other views."""
