"""Checks of a given calibration with matches between the images."""
