"""Time offsets between cameras without a common trigger."""
