"""The form of a problem that shares compiled code: equal for equal functions, another for a changed one."""

import equinox as eqx
import jax.numpy as jnp
import pytest

import jaxscp as js
from jaxscp.problem.canonical import canonical

WEIGHT = 1.0


class Damped(js.Dynamics):
    """A point whose rate depends on a global."""

    state_size: int = eqx.field(static=True, default=1)
    control_size: int = eqx.field(static=True, default=1)

    def __call__(self, state, control, time):
        """The rate."""
        return control - WEIGHT * state


def _rate(x, u, t, p):
    return WEIGHT * u[0] ** 2


def _problem(dynamics):
    size = dynamics.state_size
    ends = js.fixed_state(jnp.zeros(size)), js.fixed_state(jnp.ones(size))
    return js.OptimalControlProblem(
        dynamics, js.Cost(running=_rate), js.Boundary(*ends), js.Time(5, js.FixedTime(1.0))
    )


@pytest.mark.parametrize(
    "dynamics",
    [Damped(), js.with_integral(js.DoubleIntegrator(1), _rate)],
    ids=["subclass", "integral"],
)
def test_dynamics_that_read_a_changed_value_are_others(dynamics):
    global WEIGHT
    forms = []
    for value in (1.0, 1.0, 2.0):
        WEIGHT = value
        forms.append(canonical(_problem(dynamics)))
    assert forms[0].dynamics.function == forms[1].dynamics.function != forms[2].dynamics.function
    assert forms[0].cost.running == forms[1].cost.running != forms[2].cost.running
