"""What every other package uses: cameras, files, formats, processes."""
