"""Measurements of the planner and of rival solvers."""
