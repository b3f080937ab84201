"""Kinds of scenes: object scenes on black, and full scenes with a static background. The common interface of both kinds
is :class:`fourd.training.scenes.scene.TrainingScene`. The rest of the training code works with both kinds of scenes.
"""
