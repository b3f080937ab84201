"""Bundle adjustment of the given cameras to the pictures, before carving."""
