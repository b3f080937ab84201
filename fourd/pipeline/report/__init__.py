"""The last lines of ``fourd train`` and ``fourd make``."""
