"""Other solvers of the landing problem, independent of the planner, for comparison."""
