"""What a run shows to programs that watch it, and the requests that it takes from them, as small files in ``live/``.

The files are the only connection between training and ``fourd serve``. Training opens no port and waits for no other
program.
"""
