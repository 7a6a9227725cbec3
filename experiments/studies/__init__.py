"""Studies of the tool itself: the paper, real axes, known machines."""
