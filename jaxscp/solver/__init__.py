"""A method and a problem, or a scenario that states one, make a solution."""
