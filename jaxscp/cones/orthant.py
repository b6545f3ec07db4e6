"""Nesterov-Todd scaling of the nonnegative orthant."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class OrthantScaling(eqx.Module):
    """Scaling W of a slack s and a multiplier y, both positive: W^2 = s / y, row by row."""

    slack: Float[Array, "*b"]
    multiplier: Float[Array, "*b"]

    def square(self, v: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """W^2 v."""
        return v * self.slack / self.multiplier

    def inverse_square(self, v: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """W^-2 v."""
        return v * self.multiplier / self.slack

    def inverse_square_parts(self) -> tuple[Float[Array, "*b"], None]:
        """W^-2 as a diagonal, without a rank-one part."""
        return self.inverse_square(jnp.ones_like(self.slack)), None
