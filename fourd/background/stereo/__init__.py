"""Multi-view stereo: estimation, fusion and completion of depth maps of images with known cameras."""
