"""The page of a run: curves, pictures, state and buttons. The server reads the files of the run, and writes only the
file that contains the request to the training."""
