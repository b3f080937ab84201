"""Stages that correct the calibration and the colours of cameras."""
