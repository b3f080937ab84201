"""What the window draws over the picture: time bar, start screen, help and notices."""
