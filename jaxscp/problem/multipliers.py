"""Multipliers of the nonlinear problem: sensitivities of the cost to its constraints."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Nodes


class Multipliers(eqx.Module):
    """Multipliers of the dynamics, of the conditions at both ends, and of the constraints."""

    flow: Float[Array, "intervals states"]
    """lambda: of F(w_i) = x_{i+1}."""
    initial: Float[Array, "initial"]
    """Of the conditions at the start."""
    final: Float[Array, "final"]
    """Of the conditions at the end."""
    values: tuple[Float[Array, "_ _ _"], ...]
    """y: of the ``inequalities``, in the dual of their cones."""

    def by_interval(self) -> tuple[Float[Array, "intervals _ _"], ...]:
        """y of the constraints, in the shape of ``Outputs.values``.

        A constraint at nodes gives every interval the multiplier of its first node.
        """
        return tuple(y[: self.flow.shape[0]] for y in self.values[:-1])

    @property
    def dilation(self) -> Nodes:
        """The larger multiplier of each node's two dilation limits."""
        return jnp.max(self.values[-1][:, 0, :2], axis=1)
