"""Bundle adjustment of a rig and the positions of a board, with the time at which each camera sees each corner."""
