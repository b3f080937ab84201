"""Initial points of a static background from clean plates."""
