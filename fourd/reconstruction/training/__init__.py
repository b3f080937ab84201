"""The training of a run: scenes, loss terms, schedule, training loop, checkpoints and evaluation. A run is the folder
with the config and the results of one training.

``loop.Trainer`` runs the training loop: the module ``schedule`` selects the frame and the views of each training step,
and the module ``step`` performs the step. The trainer also logs metrics, validates, and saves checkpoints. The package
``scenes`` contains everything that differs between object scenes (only the foreground) and full scenes (foreground and
static background). The package ``losses`` contains the loss terms.
"""
