"""Bundle adjustment of given cameras with feature matches, which runs before the scene's visual hull is carved."""
