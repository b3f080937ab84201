"""Training of a run: scenes, loss terms, schedule, training loop, checkpoints and evaluation.

``loop.Trainer`` samples each step with ``schedule``, and performs the step with ``step``. The trainer also logs
metrics, validates, and saves checkpoints. ``scenes`` contains everything that differs between object scenes and full
scenes. ``losses`` contains the loss terms.
"""
