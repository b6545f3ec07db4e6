"""A planner: check a scenario, build its problem, solve, certify."""
