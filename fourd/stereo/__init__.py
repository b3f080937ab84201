"""Multi-view stereo for images with known cameras: estimation, fusion and completion of depth maps."""
