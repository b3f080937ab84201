"""Multi-view stereo for images with known cameras: features, depth maps and their fusion."""
