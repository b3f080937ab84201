"""Points of frames: parameters, optimizer, storage and densification."""
