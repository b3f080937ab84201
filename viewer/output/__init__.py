"""Writers of PNG and MP4 files."""
