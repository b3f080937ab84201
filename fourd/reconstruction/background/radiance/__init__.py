"""A radiance field of a static background, optimised to match the clean plates (Instant-NGP, Mueller et al. 2022)."""
