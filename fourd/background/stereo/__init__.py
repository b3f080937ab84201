"""Multi-view stereo: depth maps of pictures with known cameras, their fusion and completion."""
