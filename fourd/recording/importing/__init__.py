"""Import of captures in the formats of other programs: reading, time alignment, calibration and writing."""
