"""Sequential convex programming: the outer loops."""
