"""The members of packed scenes (version 3 of the `.4dv`): encoding and decoding of one cloud of points."""
