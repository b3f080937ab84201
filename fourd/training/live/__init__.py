"""Small files in ``live/``, with the state of a training for other programs, and with requests of other programs to
the training.

The files are the only connection between training and ``fourd serve``. Training opens no port, and does not wait for
other programs.
"""
