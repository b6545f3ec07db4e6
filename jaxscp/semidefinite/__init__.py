"""The nearest positive semidefinite matrices: negative eigenvalues become zero."""

from jaxscp.semidefinite.nearest import nearest

__all__ = ["nearest"]
