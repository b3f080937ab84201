"""Import of other programs' captures: formats, alignment in time, calibration, and writing."""
