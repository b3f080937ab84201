"""Readers of file formats that importers share or that are long: COLMAP models, HDF5, and OpenCV matrices in TOML."""
