"""From recordings to a capture: cameras, images, mattes."""
