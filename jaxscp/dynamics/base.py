"""Equations of motion: a state, a control, and how fast the state changes."""

import abc

import equinox as eqx
from jaxtyping import Array, Float


class Dynamics(eqx.Module):
    """Equations of motion, which do not depend on time."""

    @property
    @abc.abstractmethod
    def state_size(self) -> int:
        """Number of states."""

    @property
    @abc.abstractmethod
    def control_size(self) -> int:
        """Number of controls."""

    @abc.abstractmethod
    def __call__(
        self, state: Float[Array, "states"], control: Float[Array, "controls"]
    ) -> Float[Array, "states"]:
        """Time derivative of the state."""
