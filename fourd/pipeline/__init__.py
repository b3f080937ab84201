"""The pipeline from videos or a capture to a scene: its stages, the graph that orders the stages, and the runner that
executes them and skips finished stages."""
