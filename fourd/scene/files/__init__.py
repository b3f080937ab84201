"""Checked access to the ZIP archive and the JSON of a `.4dv`, which are untrusted input. The package also
defines the quantisation parameters of packed scenes (scenes with quantised and compressed points)."""
