"""The cameras of a run: their selection, and their corrections that are learnt while training."""
