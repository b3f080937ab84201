"""Training of a run: scenes, loss terms, schedule, training loop, checkpoints and evaluation.

``loop.Trainer`` runs the steps. It samples each step with ``schedule``, performs it with ``step``, logs metrics,
validates, and saves checkpoints. ``scenes`` contains everything that differs between objects and full scenes.
``losses`` contains the loss terms.
"""
