"""Ray tracing of triangle meshes (``csrc/rays``)."""
