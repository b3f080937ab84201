"""Initial points of a static background, computed from clean plates."""
