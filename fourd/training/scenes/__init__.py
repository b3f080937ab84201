"""Kinds of scenes: objects on black, and full scenes with a static background.

:class:`fourd.training.scenes.scene.TrainingScene` is the interface; the rest of training works with either kind.
"""
