"""Dynamics with more states: decision variables that do not change, and integrals along the trajectory."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.dynamics.base import Dynamics, FunctionDynamics
from jaxscp.dynamics.double_integrator import DoubleIntegrator
from jaxscp.dynamics.rigid_body import RigidBody


def with_static(dynamics: Dynamics, count: int = 1) -> Dynamics:
    """Dynamics with ``count`` more states, last, of zero derivative: decision variables that do not change.

    Leave them free at both ends. Functions of the problem find them at the end of the state.

    Example:
        >>> import jaxscp
        >>> jaxscp.with_static(jaxscp.DoubleIntegrator(1), 2).state_size
        4
    """
    return _WithStatic(dynamics, count)


def with_integral(dynamics: Dynamics, integrand: Callable[..., Any], parameters: Any = ()) -> Dynamics:
    """Dynamics with one more state, last: the integral of a function of time, from the start on.

    Fix it to zero at the start. A condition on its end is an integral constraint.

    Args:
        dynamics: of the other states.
        integrand: (state, control, time, parameters) -> number, of the other states.
        parameters: of the integrand, a pytree.

    Example:
        >>> import jax.numpy as jnp, jaxscp
        >>> energy = jaxscp.with_integral(jaxscp.DoubleIntegrator(1), lambda x, u, t, p: u @ u)
        >>> energy(jnp.array([0.0, 1.0, 0.0]), jnp.array([3.0]), 0.0).tolist()
        [1.0, 3.0, 9.0]
    """
    return _WithIntegral(dynamics, integrand, parameters)


class _Augmented(Dynamics):
    """Dynamics with more states than the inner ones."""

    inner: Dynamics

    @property
    def control_size(self) -> int:
        """Of the inner dynamics."""
        return self.inner.control_size


class _WithStatic(_Augmented):
    count: int = eqx.field(static=True)

    @property
    def state_size(self) -> int:
        """Inner states, and the static ones."""
        return self.inner.state_size + self.count

    def __call__(
        self, state: Float[Array, "states"], control: Float[Array, "controls"], time: Scalar | float
    ) -> Float[Array, "states"]:
        """Zero for the static ones."""
        rate = self.inner(state[: -self.count], control, time)
        return jnp.concatenate([rate, jnp.zeros(self.count, state.dtype)])


class _WithIntegral(_Augmented):
    integrand: Callable[..., Any] = eqx.field(static=True)
    parameters: Any

    @property
    def state_size(self) -> int:
        """Inner states, and the integral."""
        return self.inner.state_size + 1

    def __call__(
        self, state: Float[Array, "states"], control: Float[Array, "controls"], time: Scalar | float
    ) -> Float[Array, "states"]:
        """The integrand, for the integral."""
        inner = state[:-1]
        grows = self.integrand(inner, control, time, self.parameters)
        return jnp.append(self.inner(inner, control, time), grows)


DYNAMICS = FunctionDynamics, DoubleIntegrator, RigidBody, _WithStatic, _WithIntegral
"""All dynamics of this package: files name their classes."""


def can_be_stored(dynamics: Dynamics | None) -> bool:
    """Whether a file can hold the dynamics: their class is this package's, and they have no function."""
    inner = dynamics.inner if isinstance(dynamics, _WithStatic) else dynamics
    return inner is None or isinstance(inner, DoubleIntegrator | RigidBody)
