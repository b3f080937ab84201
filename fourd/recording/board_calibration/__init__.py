"""Calibration of a rig from videos of a moving calibration board."""
