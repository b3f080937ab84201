"""Drawing and depth-sorting of baked points (``csrc/play``)."""
