"""Commands that train runs and turn them into scenes."""
