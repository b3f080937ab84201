"""Small files in a run's folder ``live/``: the state of the training process for other programs, and their requests to
it.

These files are the only connection between training and ``fourd serve``. Training opens no port and does not wait for
other programs.
"""
