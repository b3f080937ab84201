"""The playback clock, frame sources and prefetching."""
