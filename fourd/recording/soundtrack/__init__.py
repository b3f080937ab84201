"""Soundtracks: the one that a capture keeps, chosen from its videos or given by the user, as Opus in an Ogg file."""
