"""The page of a run: curves, pictures, state and buttons. The server reads the files of the run. It writes only one of
these files, which contains the request to the training."""
