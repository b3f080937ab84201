"""A radiance field of a still background (Mueller et al. 2022, Instant-NGP), fitted to clean plates."""
