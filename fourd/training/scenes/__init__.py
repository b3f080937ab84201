"""Kinds of scenes: object scenes on black, and full scenes with a static background. The common interface of both kinds
is :class:`fourd.training.scenes.scene.TrainingScene`. The other modules of the training code work with both kinds of
scenes.
"""
