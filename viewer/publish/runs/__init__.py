"""The page of a run: curves, pictures, state and buttons. The server reads the files of the run, and writes only
requests to its training."""
