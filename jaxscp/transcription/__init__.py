"""From an optimal control problem to a nonlinear program on its nodes."""
