"""Estimation of time offsets between cameras without a common trigger."""
