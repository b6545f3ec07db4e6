"""Small structured linear algebra: eigenvalues, Riccati recursion, Gram matrices, block tridiagonal systems."""
