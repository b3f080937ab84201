"""PNG and MP4 files."""
