"""Equations of motion: a state, a control, the time, and how fast the state changes."""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar


class Dynamics(eqx.Module):
    """Equations of motion; parameters are leaves of the subclass."""

    @property
    @abc.abstractmethod
    def state_size(self) -> int:
        """Number of states."""

    @property
    @abc.abstractmethod
    def control_size(self) -> int:
        """Number of controls."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states in tables, with units."""
        return tuple(f"x{i}" for i in range(self.state_size))

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the controls in tables, with units."""
        return tuple(f"u{i}" for i in range(self.control_size))

    @property
    def rate_names(self) -> tuple[str, ...]:
        """Names of the states' derivatives in tables; a derivative without one is left out."""
        return tuple(f"d{name}/dt" for name in self.state_names)

    @abc.abstractmethod
    def __call__(
        self, state: Float[Array, "states"], control: Float[Array, "controls"], time: Scalar | float
    ) -> Float[Array, "states"]:
        """Time derivative of the state."""

    @staticmethod
    def of(
        function: Callable[..., Any],
        states: int | np.integer,
        controls: int | np.integer,
        parameters: Any = (),
    ) -> FunctionDynamics:
        """Dynamics from a plain function.

        Args:
            function: (state, control, time, parameters) -> time derivative of the state; pure.
            states: number of states.
            controls: number of controls.
            parameters: a pytree of numbers and arrays, which gradients and batches reach.

        Example:
            >>> import jax.numpy as jnp
            >>> from jaxscp.dynamics.base import Dynamics
            >>> fall = lambda x, u, t, gravity: jnp.stack([x[1], u[0] - gravity])
            >>> falling = Dynamics.of(fall, states=2, controls=1, parameters=9.81)
            >>> falling(jnp.array([0.0, 3.0]), jnp.array([9.81]), 0.0).tolist()
            [3.0, 0.0]
        """
        # NumPy's whole numbers are arrays to Equinox, which warns of arrays in static fields.
        plain = lambda size: int(size) if isinstance(size, np.integer) else size  # noqa: E731
        return FunctionDynamics(function, plain(states), plain(controls), parameters)


class FunctionDynamics(Dynamics):
    """Dynamics from a plain function, see ``Dynamics.of``."""

    function: Callable[..., Any] = eqx.field(static=True)
    states: int = eqx.field(static=True)
    controls: int = eqx.field(static=True)
    parameters: Any = ()

    @property
    def state_size(self) -> int:
        """As given."""
        return self.states

    @property
    def control_size(self) -> int:
        """As given."""
        return self.controls

    def __call__(
        self, state: Float[Array, "states"], control: Float[Array, "controls"], time: Scalar | float
    ) -> Float[Array, "states"]:
        """The function's value."""
        return self.function(state, control, time, self.parameters)
