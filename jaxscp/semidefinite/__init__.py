"""Symmetric matrices by their eigenvalues: what these are, the nearest matrices without negative ones,
and pseudo-inverses."""

from jaxscp.semidefinite.nearest import eigen, nearest
from jaxscp.semidefinite.pseudo_inverse import pseudo_inverse

__all__ = ["eigen", "nearest", "pseudo_inverse"]
