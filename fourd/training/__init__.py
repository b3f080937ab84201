"""Training of a run: scenes, loss terms, schedule, training loop, checkpoints and evaluation.

``loop.Trainer`` samples a step (``schedule``), trains on it (``step``), logs, validates and saves checkpoints. What
differs between objects and full scenes is in ``scenes``; loss terms are in ``losses``.
"""
