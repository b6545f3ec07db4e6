"""The cones of a convex program, and all algebra on them."""
