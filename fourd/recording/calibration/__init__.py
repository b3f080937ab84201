"""Camera calibration: checks against the images, resolution of ambiguities, and calibration from images only."""
