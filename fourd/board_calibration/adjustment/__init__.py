"""Bundle adjustment of a rig and the positions of a board. The model includes the time at which each camera sees each
corner."""
