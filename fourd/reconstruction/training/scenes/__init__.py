"""Kinds of scenes: object scenes, which contain only the foreground, and full scenes, which also have a static
background. Both implement the interface :class:`fourd.reconstruction.training.scenes.scene.TrainingScene`, so the
training code outside this package works with both.
"""
