"""How well a calibration agrees with its pictures, and cameras from pictures alone."""
