"""The pipeline from videos or a capture to a scene: the stages, the graph that orders them, and the runner that
executes them and skips finished ones."""
