"""Cameras as a run knows them: corrections learned while training."""
