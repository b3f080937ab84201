"""Bundle adjustment of the given cameras with feature matches between images, before carving."""
