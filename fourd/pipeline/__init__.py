"""From videos to a scene: the stages, and the graph that runs each once."""
