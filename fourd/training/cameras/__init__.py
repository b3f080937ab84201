"""The cameras of a run: their selection, and corrections that are learnt while training."""
