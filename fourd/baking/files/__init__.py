"""Checked access to the ZIP archive and to the JSON of a `.4dv`, which are untrusted input. This package also has the
encoding of packed scenes."""
