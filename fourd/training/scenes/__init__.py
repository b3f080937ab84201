"""Kinds of scenes: objects on black, and full scenes with a static background.

:class:`fourd.training.scenes.scene.Scene` is the interface; everything else in training works with either kind.
"""
