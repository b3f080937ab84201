"""Bundle adjustment of a rig and a board's positions. The model includes the time at which each camera sees each
corner."""
