"""Right-hand sides, path outputs and random intervals that tests integrate."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.dynamics.airframes import paper_mav
from jaxscp.dynamics.double_integrator import DoubleIntegrator
from jaxscp.integration import in_jax
from jaxscp.integration.intervals import IntervalData, Intervals, OutputGroup, PathOutputs, without_data

ROUNDING = 1e-12  # relative: implementations add the same terms in different orders
COUNT = 19  # intervals: more than two registers hold, and no multiple of their width


class RigidBody(eqx.Module):
    """Rigid-body dynamics with a running cost that is no polynomial."""

    body: eqx.Module

    def __call__(self, state, control):
        u, s = control[:-1], control[-1]
        return s * jnp.append(self.body(state, u), jnp.sqrt(1.0 + jnp.sum(u * u)))


class Line(eqx.Module):
    """A double integrator, which has no parameters."""

    def __call__(self, state, control):
        return control[-1] * jnp.append(DoubleIntegrator(1)(state, control[:-1]), control[0] ** 3)


class EveryOperation(eqx.Module):
    """Every operation that a tape can hold, on two states and one control."""

    weight: jax.Array

    def __call__(self, state, control):
        x, y = state
        u, s = control
        trigonometric = jnp.sin(x) * jnp.cos(self.weight[0] * y) - jnp.tanh(u)
        smooth = jnp.exp(-(x**2)) / (1.0 + y**2) + jnp.log(2.0 + u**2) + jnp.sqrt(3.0 + x * y) + x**-2
        kinked = jnp.maximum(x, y) + jnp.minimum(y, u) - jnp.abs(x - self.weight[1])
        chosen = jnp.where(x < y, x * u, jnp.where(y >= u, y, x * self.weight[0])) + jnp.where(x > u, u, y)
        order = jnp.where(x <= u, 1.0, x) * jnp.where(x == x, 1.0, y)
        flipped = jnp.flip(jnp.stack([x, y])) @ jnp.outer(state, self.weight[:2])
        return s * jnp.stack([trigonometric + kinked, smooth + chosen * order, jnp.sum(flipped)])


RATES = {
    "rigid body": (RigidBody(paper_mav().body), 13, 5),
    "no parameters": (Line(), 2, 2),
    "every operation": (EveryOperation(jnp.array([0.7, 0.4, 1.1])), 2, 2),
}
"""(rate, states, controls)"""
ORDERS = {"evaluate": 0, "linearise": 1, "linearise_with_hessian": 2}
"""Functions of ``dispatch`` and ``in_jax``, by highest derivative."""


def subtract_margin(values, mask):
    """A margin for each row, a function of the row's values at neighbouring points."""
    neighbours = jnp.concatenate([values[1:], values[:1]]) * values
    return values - mask[:, None] * jnp.sqrt(1.0 + neighbours * neighbours)


class Rows(eqx.Module):
    """Five rows at the points, and three functions of the interval's variables."""

    states: int = eqx.field(static=True)

    def at_point(self, state, controls, data):
        weights, limit = jax.tree.map(lambda v: v.astype(state.dtype), data)
        rows = [
            jnp.dot(weights, state[:2]) * controls[-1],
            state[0] * state[1],
            limit,
            state[1] - controls[0],
        ]
        return jnp.stack([*rows, jnp.maximum(state[0], limit) ** 2])

    def at_ends(self, w, data):
        return jnp.stack([data[0] * w[0] * w[self.states], w[-1] ** 3, data[1]])


def path_outputs(states):
    """Two rows that share a margin, and three with a margin each."""
    rows = Rows(states)
    groups = (OutputGroup(2, 2, subtract_margin), OutputGroup(3, 1, subtract_margin))
    return PathOutputs(rows.at_point, rows.at_ends, groups)


def random_case(rate, states, controls, method, order=2, outputs=True):
    """Arguments of the integration up to an order; outputs at every second step."""
    keys = jax.random.split(jax.random.key(0), 5)
    w = 0.3 + jax.random.uniform(keys[0], (COUNT, states + 2 * controls))
    if outputs:
        intervals = Intervals(rate, states, method, 6, 2, path_outputs(states))
        point = jax.random.normal(keys[1], (COUNT, 2)), jax.random.normal(keys[2], (COUNT,))
        mask = jnp.ones((COUNT, 4)).at[0, 0].set(0.0)
        data = IntervalData(point, jax.random.normal(keys[3], (COUNT, 2)), mask)
    else:
        intervals = Intervals(rate, states, method, 4, 4)
        data = without_data(intervals, COUNT)
    if order < 2:
        return intervals, w, data
    like = jax.eval_shape(in_jax.evaluate, intervals, w, data)
    random = np.random.default_rng(1)
    return intervals, w, data, jax.tree.map(lambda v: jnp.asarray(random.standard_normal(v.shape)), like)


def assert_same(expected, found, tolerance=ROUNDING):
    """Equal leaves, within a tolerance relative to the largest entry of each."""
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        size = float(jnp.max(jnp.abs(a), initial=1.0))
        np.testing.assert_allclose(b, a, rtol=0, atol=tolerance * size)
