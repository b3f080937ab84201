"""The stages of the pipeline, one file each: its typed files and settings, and its work."""
