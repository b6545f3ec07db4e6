"""A method and a problem make a solution."""
