"""Small files in the folder ``live/`` of a run: the state of training for other programs, and requests from other
programs to the training.

The files are the only connection between training and ``fourd serve``. Training opens no port, and does not wait for
other programs.
"""
