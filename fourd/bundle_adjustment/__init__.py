"""Bundle adjustment of given cameras with feature matches between images. Bundle adjustment runs before carving."""
