"""Bundle adjustment of given cameras from feature matches between images, which runs before the scene is carved."""
