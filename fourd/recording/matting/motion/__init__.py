"""Mattes without a network: foreground and background models learned from motion and multi-view consistency."""
