"""A point mass under direct acceleration."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.dynamics.base import Dynamics


class DoubleIntegrator(Dynamics):
    """A point mass under direct acceleration: state (position, velocity), control acceleration.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.dynamics.double_integrator import DoubleIntegrator
        >>> DoubleIntegrator(1)(jnp.array([0.0, 2.0]), jnp.array([3.0])).tolist()
        [2.0, 3.0]
    """

    dimension: int = eqx.field(default=3, static=True)

    @property
    def state_size(self) -> int:
        """Twice the dimension."""
        return 2 * self.dimension

    @property
    def control_size(self) -> int:
        """The dimension."""
        return self.dimension

    def __call__(
        self, state: Float[Array, "states"], control: Float[Array, "controls"], time: Scalar | float = 0.0
    ) -> Float[Array, "states"]:
        """(velocity, acceleration)."""
        return jnp.concatenate([state[self.dimension :], control])
