"""First-order hold: closed forms, an independent integrator, and the order of convergence."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxscp import airframes
from jaxscp.dynamics.base import Dynamics
from jaxscp.dynamics.double_integrator import DoubleIntegrator
from jaxscp.problem.boundary import Boundary, fixed_state
from jaxscp.problem.cost import Cost
from jaxscp.problem.form import Continuous
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.problem.time import FreeTime, Time
from jaxscp.transcription.discretise import discretise
from jaxscp.transcription.layout import interval_variables

EXACT = 1e-12  # RK4 integrates these polynomials exactly, except for rounding
INDEPENDENT = 1e-8  # twenty RK4 steps over a tenth of a second, compared with an integration to 1e-12


class SingleIntegrator(Dynamics):
    """x' = u."""

    @property
    def state_size(self) -> int:
        return 1

    @property
    def control_size(self) -> int:
        return 1

    def __call__(self, state, control, time):
        return control


def quadratic_cost(state, control, time, parameters):
    return jnp.sum(control**2)


def problem_of(dynamics, nodes: int) -> ScaledTimeProblem:
    free = fixed_state([None] * dynamics.state_size)
    problem = OptimalControlProblem(
        dynamics, Cost(quadratic_cost), Boundary(free, free), Time(nodes, FreeTime(0.1, 10.0))
    )
    return over_scaled_time(problem, Continuous())


def random_node_variables(problem, key, dilation=None):
    z = jax.random.normal(key, (problem.nodes, problem.variables))
    s = 2.0 * jnp.ones(problem.nodes) if dilation is None else dilation
    return z.at[:, -1].set(s)


def test_single_integrator_with_varying_dilation():
    """x+ = x + h ((2 s0 + s1) u0 + (s0 + 2 s1) u1) / 6, h: length of the interval in scaled time."""
    problem = problem_of(SingleIntegrator(), 4)
    z = random_node_variables(problem, jax.random.key(0), jnp.array([1.0, 2.0, 0.5, 3.0]))
    flow = discretise(problem, z, 10)
    h = 1.0 / 3.0
    x, u, s = z[:-1, 0], z[:, 1], z[:, 2]
    u0, u1, s0, s1 = u[:-1], u[1:], s[:-1], s[1:]
    end = x + h * (s0 * u0 / 3 + s0 * u1 / 6 + s1 * u0 / 6 + s1 * u1 / 3)
    np.testing.assert_allclose(flow.state[:, 0], end, atol=EXACT)
    ones = jnp.ones_like(x)
    expected = [
        ones,
        h * (s0 / 3 + s1 / 6),
        h * (u0 / 3 + u1 / 6),
        h * (s0 / 6 + s1 / 3),
        h * (u0 / 6 + u1 / 3),
    ]
    np.testing.assert_allclose(flow.state_jacobian[:, 0], jnp.stack(expected, axis=1), atol=EXACT)


def test_double_integrator_at_constant_dilation():
    """A = [1 h; 0 1], B- = [h^2 / 3, h / 2], B+ = [h^2 / 6, h / 2], h: length of the interval, s."""
    problem = problem_of(DoubleIntegrator(1), 5)
    z = random_node_variables(problem, jax.random.key(1))
    flow = discretise(problem, z, 10)
    h = 2.0 / 4.0
    A = np.array([[1.0, h], [0.0, 1.0]])
    for i in range(4):
        jacobian = flow.state_jacobian[i]
        np.testing.assert_allclose(jacobian[:, :2], A, atol=EXACT)
        np.testing.assert_allclose(jacobian[:, 2], [h**2 / 3, h / 2], atol=EXACT)
        np.testing.assert_allclose(jacobian[:, 4], [h**2 / 6, h / 2], atol=EXACT)


def test_running_cost_is_integrated():
    """The integral of u^2 over an interval of first-order hold is h (u0^2 + u0 u1 + u1^2) / 3."""
    problem = problem_of(DoubleIntegrator(1), 5)
    z = random_node_variables(problem, jax.random.key(2))
    u0, u1 = z[:-1, 2], z[1:, 2]
    np.testing.assert_allclose(
        discretise(problem, z, 10).cost, 0.5 * (u0**2 + u0 * u1 + u1**2) / 3, atol=EXACT
    )


@pytest.fixture(scope="module")
def quadrotor():
    """A problem, and node variables of a trajectory with turns, tilt and varying dilation."""
    problem = problem_of(airframes.paper_mav().body, 3)
    z = 0.3 * jax.random.normal(jax.random.key(3), (3, problem.variables))
    q = z[:, 6:10].at[:, 0].add(1.0)
    z = z.at[:, 6:10].set(q / jnp.linalg.norm(q, axis=1, keepdims=True))
    z = z.at[:, 13:17].set(2.3 + 0.02 * z[:, 13:17])
    return problem, z.at[:, -1].set(jnp.array([0.2, 0.25, 0.15]))


def integrated(problem, w):
    """End state and Jacobian of one interval from the variational equations, by DOP853 at 1e-12."""
    n, m, width = 13, 5, 1.0 / (problem.nodes - 1)

    def rate(x, control):
        return control[-1] * problem.dynamics(x, control[:-1], 0.0)

    value = jax.jit(rate)
    in_state, in_control = jax.jit(jax.jacrev(rate)), jax.jit(jax.jacrev(rate, argnums=1))
    first, last = w[n : n + m], w[n + m :]

    def right(share, flat):
        x, S = flat[:n], flat[n:].reshape(n, n + 2 * m)
        control = first + share * (last - first)
        B = np.asarray(in_control(x, control))
        forced = np.concatenate([np.zeros((n, n)), (1 - share) * B, share * B], axis=1)
        return width * np.concatenate(
            [value(x, control), (np.asarray(in_state(x, control)) @ S + forced).ravel()]
        )

    start = np.concatenate([w[:n], np.eye(n, n + 2 * m).ravel()])
    end = solve_ivp(right, (0.0, 1.0), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    return end[:n], end[n:].reshape(n, n + 2 * m)


def test_quadrotor_against_an_independent_integration(quadrotor):
    problem, z = quadrotor
    flow = discretise(problem, z, 20)
    w = np.asarray(interval_variables(problem, z))
    for i in range(problem.nodes - 1):
        end, jacobian = integrated(problem, w[i])
        np.testing.assert_allclose(flow.state[i], end, atol=INDEPENDENT)
        np.testing.assert_allclose(flow.state_jacobian[i], jacobian, atol=INDEPENDENT)
        offset = flow.state[i] - flow.state_jacobian[i] @ w[i]
        np.testing.assert_allclose(offset, end - jacobian @ w[i], atol=INDEPENDENT)


def test_error_falls_with_the_fourth_power_of_the_substeps(quadrotor):
    problem, z = quadrotor
    z = z.at[:, -1].multiply(8.0)  # long intervals, so that the error is far above rounding
    ends = [discretise(problem, z, steps).state for steps in (4, 8, 16, 256)]
    errors = [float(jnp.max(jnp.abs(end - ends[-1]))) for end in ends[:-1]]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(orders > 3.6), (errors, orders)
    assert np.all(orders < 4.6), (errors, orders)


def test_extended_problem_carries_cost_and_time(quadrotor):
    problem, z = quadrotor
    object_fields = {f: getattr(problem, f) for f in problem.__dataclass_fields__}
    extended = type(problem)(**{**object_fields, "carries_cost": True, "carries_time": True})
    parts = jax.vmap(problem.split)(z)
    wide = extended.join(parts[0], parts[2], parts[3])
    plain, carried = discretise(problem, z, 10), discretise(extended, wide, 10)
    np.testing.assert_allclose(carried.state[:, :13], plain.state, atol=EXACT)
    np.testing.assert_allclose(carried.state[:, 13] - wide[:-1, 13], plain.cost, atol=EXACT)
    h = 0.5 * 0.5 * (z[:-1, -1] + z[1:, -1])
    np.testing.assert_allclose(carried.state[:, 14] - wide[:-1, 14], h, atol=EXACT)
    assert eqx.tree_equal(carried.cost_jacobian.shape, (2, wide.shape[1] + 5))
