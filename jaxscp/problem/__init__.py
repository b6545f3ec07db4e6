"""An optimal control problem, in general."""
