"""Training of a run: loss terms, schedule, loop, checkpoints."""
