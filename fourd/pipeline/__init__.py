"""The pipeline from videos or a capture to a scene. This package has the stages, the graph that orders the stages, and
the runner that executes stages and skips finished ones."""
