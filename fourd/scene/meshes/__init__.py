"""Reading and drawing of triangle meshes without torch."""
