"""A radiance field of a static background, optimised on clean plates (Instant-NGP, Mueller et al. 2022)."""
