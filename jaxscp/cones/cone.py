"""The convex cones that the values of a constraint lie in."""

import equinox as eqx


class Cone(eqx.Module):
    """A convex cone that a constraint's values must lie in."""


class Zero(Cone):
    """Every value is zero: an equality."""


class NonNegative(Cone):
    """Every value is zero or more."""


class SecondOrder(Cone):
    """The values (t, v) obey |v| <= t."""
