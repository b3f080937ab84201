"""Estimation of time offsets between cameras that have no common trigger."""
