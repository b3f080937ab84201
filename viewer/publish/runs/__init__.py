"""Serves the page of a run, which shows curves, validation images, the state and buttons. The server only reads the
run's files, except for one file through which it sends requests to the training process."""
