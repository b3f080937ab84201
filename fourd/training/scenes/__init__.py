"""Kinds of scenes: objects on black, and full scenes with a static background. Their common interface is
:class:`fourd.training.scenes.scene.TrainingScene`. The rest of training works with both kinds.
"""
