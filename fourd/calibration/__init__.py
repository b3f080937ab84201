"""Camera calibration: how well it agrees with the pictures, what it leaves open, and calibration from pictures."""
