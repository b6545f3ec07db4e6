"""A general problem: a double integrator whose minimum time is known in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp import PTR, NormTrustRegion, ProximalTrustRegion, Status
from jaxscp.cones.cone import NonNegative
from jaxscp.dynamics.double_integrator import DoubleIntegrator
from jaxscp.landing.constraints import Limits, within_control_limits
from jaxscp.problem.constraint import Constraint, repeat_over_nodes
from jaxscp.problem.problem import (
    Boundary,
    FixedComponents,
    OptimalControlProblem,
    fixed_components,
    node_times,
)

NODES = 21  # even number of intervals, so that the switch of a bang-bang control can fall on a node
LIMIT = 2.0  # m/s^2

# First-order hold cannot jump from +a to -a. With a free mesh, the change takes the shortest interval that the
# dilation's lower bound allows. This costs less than this fraction of the minimum time.
SWITCH = 1e-4


def no_effort(state, control, weights):
    return jnp.zeros(())


def final_time(state, time, weights):
    return time


def rest_to_rest(distance: float) -> OptimalControlProblem:
    everything = jnp.ones(2)
    return OptimalControlProblem(
        dynamics=DoubleIntegrator(1),
        running_cost=no_effort,
        terminal_cost=final_time,
        weights=(),
        constraints=(
            Constraint(
                within_control_limits,
                repeat_over_nodes(Limits(jnp.array([-LIMIT]), jnp.array([LIMIT])), NODES),
                NonNegative(),
                jnp.ones(NODES, bool),
                "acceleration",
            ),
        ),
        initial=Boundary(fixed_components, FixedComponents(jnp.zeros(2), everything)),
        final=Boundary(fixed_components, FixedComponents(jnp.array([distance, 0.0]), everything)),
        dilation_min=jnp.asarray(0.05),
        dilation_max=jnp.asarray(10.0),
        nodes=NODES,
    )


@pytest.fixture(scope="module")
def solve():
    method = PTR(trust_region=ProximalTrustRegion(1e-4), max_iterations=60, tolerance_step=1e-3)
    return jax.jit(method.run)


def straight(problem: OptimalControlProblem, distance: float, duration: float):
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
