"""Images for compositing: opacity, depth and normals of points and meshes."""
