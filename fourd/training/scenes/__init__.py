"""Kinds of scenes: object scenes, which contain only the foreground, and full scenes, which also have a static
background. The common interface of both kinds is :class:`fourd.training.scenes.scene.TrainingScene`. The training
code outside this package works with both kinds of scenes.
"""
