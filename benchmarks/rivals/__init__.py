"""Other ways to solve the landing problem, written without the planner so that they can judge it."""
