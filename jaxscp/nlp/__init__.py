"""Interior point on the nonlinear program, and derivatives of its optimum."""
