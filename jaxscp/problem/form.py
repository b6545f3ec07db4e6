"""Two ways to state a problem: a method says which one it solves."""

import equinox as eqx


class Form(eqx.Module):
    """How a problem is stated."""

    @property
    def carries_cost(self) -> bool:
        """Whether the running cost so far is a state (equation 11)."""
        return False

    @property
    def carries_time(self) -> bool:
        """Whether time is a state, even if no function reads it."""
        return False

    @property
    def fixes_unit_norm(self) -> bool:
        """Whether an end condition on an attitude fixes all four components of its quaternion."""
        return False

    @property
    def even_mesh(self) -> bool:
        """Whether a landing has a small cost of an uneven mesh."""
        return False


class Continuous(Form):
    """As few states and end conditions as the problem needs; constraints hold between the nodes too.

    A small cost of an uneven mesh: without it, many meshes are nearly as good as the best, and hard to tell apart.
    """

    @property
    def even_mesh(self) -> bool:
        """True."""
        return True


class Paper(Form):
    """As in the paper: running cost and time are states, and all four components of the final quaternion are fixed.

    The dynamics keep |q|, so that one of the four is implied by the others, and multipliers are not unique.
    """

    @property
    def carries_cost(self) -> bool:
        """True."""
        return True

    @property
    def carries_time(self) -> bool:
        """True."""
        return True

    @property
    def fixes_unit_norm(self) -> bool:
        """True."""
        return True
