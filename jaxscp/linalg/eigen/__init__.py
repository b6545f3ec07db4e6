"""Eigenvalues of symmetric matrices, their nearest positive semidefinite matrices, and pseudo-inverses."""
