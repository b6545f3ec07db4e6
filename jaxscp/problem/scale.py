"""Typical sizes of a problem's quantities, as the user states them: the solver works in these units."""

import equinox as eqx
from jaxtyping import Array, Float

from jaxscp.core.arrays import floats
from jaxscp.core.types import Scalar


class Scale(eqx.Module):
    """Typical sizes, in the user's own units; a solver's variables are quotients by them.

    A problem needs none, unless the sizes that are taken from its guess, limits and dynamics are wrong by much.

    Args:
        state: size of each state.
        control: size of each control.
        time: size of the final time, s.
        cost: how much the cost changes; by default the guess's cost, which is too large if most of it is a constant.
            The barrier moves the optimal cost by about a millionth of this for each limit that binds.

    Example:
        >>> import jaxscp
        >>> ship = jaxscp.Scale(state=[1e6, 1e3], control=[1e6], time=1e3)  # m, m/s; N; s
    """

    state: Float[Array, "states"] = eqx.field(converter=floats)
    control: Float[Array, "controls"] = eqx.field(converter=floats)
    time: Scalar = eqx.field(converter=floats)
    cost: Scalar | None = eqx.field(converter=lambda v: None if v is None else floats(v), default=None)
