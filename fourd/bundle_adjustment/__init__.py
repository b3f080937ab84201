"""Bundle adjustment of given cameras, from feature matches between images. Bundle adjustment runs before carving."""
