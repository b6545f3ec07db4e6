"""Differentiable six-degree-of-freedom trajectory optimisation by sequential convex programming."""

from jaxscp import corridor as corridor
