"""Training of a run: scenes, loss terms, schedule, training loop, checkpoints and evaluation.

``loop.Trainer`` samples a step (``schedule``), trains on it (``step``), logs, validates and saves checkpoints.
``scenes`` contains everything that differs between objects and full scenes. ``losses`` contains the loss terms.
"""
