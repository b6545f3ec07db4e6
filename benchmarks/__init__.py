"""Measurements of the planner, and of the solvers it is compared with."""
