"""Small files in a run's folder ``live/``. Through them, a training process tells other programs its state, and other
programs send requests to the training process.

These files are the only connection between training and ``fourd serve``. Training opens no port and does not wait for
other programs.
"""
