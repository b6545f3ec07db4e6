"""A general problem: a double integrator whose minimum time is known in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp import PTR, NormTrustRegion, ProximalTrustRegion, Status
from jaxscp.problem.canonical import canonical
from jaxscp.problem.form import Continuous
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.problem.node_values import node_times
from jaxscp.problem.scaled_time import ScaledTimeProblem

NODES = 21  # even number of intervals, so that the switch of a bang-bang control can fall on a node
LIMIT = 2.0  # m/s^2
LEAST = 0.05  # s, of the dilation

# First-order hold cannot jump from +a to -a. With a free mesh, the change takes the shortest interval that the
# dilation's lower bound allows. This costs less than this fraction of the minimum time.
SWITCH = 1e-4


def within(state, control, time, limit):
    return jnp.concatenate([control + limit, limit - control])


def rest_to_rest(distance, limit=LIMIT, least=LEAST) -> ScaledTimeProblem:
    """Minimum time, with the acceleration limited everywhere; on a mesh that is free."""
    asked = jaxscp.OptimalControlProblem(
        dynamics=jaxscp.DoubleIntegrator(1),
        cost=jaxscp.Cost(terminal=lambda x, t, p: t),
        boundary=jaxscp.Boundary(jaxscp.fixed_state([0.0, 0.0]), jaxscp.fixed_state([distance, 0.0])),
        time=jaxscp.Time(NODES, jaxscp.FreeTime(least, 10.0), mesh_weight=None),
        constraints=(
            jaxscp.Constraint(within, jaxscp.NonNegative(), limit, convex=True, name="acceleration"),
        ),
    )
    return over_scaled_time(canonical(asked), Continuous())


@pytest.fixture(scope="module")
def solve():
    method = PTR(trust_region=ProximalTrustRegion(1e-4), max_iterations=60, tolerance_step=1e-3)
    return jax.jit(method.run)


def straight(problem: ScaledTimeProblem, distance: float, duration: float):
    share = jnp.linspace(0.0, 1.0, NODES)[:, None]
    states = jnp.concatenate([distance * share, jnp.full((NODES, 1), distance / duration)], axis=1)
    return problem.join(states, jnp.zeros((NODES, 1)), jnp.full(NODES, duration))


@pytest.mark.parametrize("distance", [1.0, 4.0])
def test_minimum_time_rest_to_rest(solve, distance):
    """Full acceleration to the middle, full braking from it: t_f = 2 sqrt(d / a)."""
    problem = rest_to_rest(distance)
    result = solve(problem, straight(problem, distance, 5.0))
    assert bool(result.status == Status.converged)
    best = 2.0 * np.sqrt(distance / LIMIT)
    duration = float(node_times(result.z[:, -1])[-1])
    assert duration >= best * (1.0 - 1e-6)
    assert duration <= best * (1.0 + SWITCH)
    np.testing.assert_allclose(result.cost, duration, rtol=1e-9)


def test_paper_trust_region_serves_it_too():
    problem = rest_to_rest(1.0)
    method = PTR(trust_region=NormTrustRegion(0.01), max_iterations=60)
    result = jax.jit(method.run)(problem, straight(problem, 1.0, 5.0))
    assert bool(result.status == Status.converged)
    assert float(result.cost) >= 2.0 * np.sqrt(1.0 / LIMIT) * (1.0 - 1e-6)
