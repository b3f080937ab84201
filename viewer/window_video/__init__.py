"""Videos that are rendered in the window, which shows the progress."""
