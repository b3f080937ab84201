"""Checks of a given calibration with feature matches between the images."""
