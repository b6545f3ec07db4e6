"""Normal matrices: what linear rows J with weights W add to a Newton system at every place, J' W J, and J' v."""

from jaxscp.normal.matrix import Normal, Rows, normal

__all__ = ["Normal", "Rows", "normal"]
