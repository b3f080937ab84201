"""Bundle adjustment of given cameras with feature matches between images. It runs before carving."""
