"""Checked access to the ZIP archive and the JSON of a `.4dv`, and the encoding of packed scenes. The archive and the
JSON are untrusted input."""
