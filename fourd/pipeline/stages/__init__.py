"""The stages of the pipeline. Each has one module with its file paths, settings and work function."""
