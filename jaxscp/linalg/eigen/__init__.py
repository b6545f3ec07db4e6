"""Symmetric matrices by their eigenvalues: the nearest positive semidefinite matrices, and pseudo-inverses."""
