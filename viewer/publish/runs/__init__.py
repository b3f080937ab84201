"""The page of a run: curves, pictures, state and buttons. The server only reads the files of the run, apart from the
requests to the training, which it writes to a file."""
