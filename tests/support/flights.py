"""Short problems and random nodes, for tests of derivatives and identities."""

import dataclasses

import jax.numpy as jnp
import numpy as np

import jaxscp
from jaxscp import scenarios
from jaxscp.landing.allocation import allocate
from jaxscp.landing.problem import landing_problem
from jaxscp.problem.canonical import canonical
from jaxscp.problem.form import Continuous
from jaxscp.problem.lowering import over_scaled_time

NODES = 8


def short_problem(everything=False):
    """Case 1 on 8 nodes; with ``everything``, also limits, zones and a moving deck."""
    scenario = scenarios.platform_to_platform()
    if everything:
        scenario = dataclasses.replace(
            scenario,
            limits=jaxscp.flight_limits(speed=6.0, tilt=0.9, body_rate=5.0, thrust_rate=20.0),
            keep_out=jaxscp.ellipsoids(
                [[1.0, 2.0, 1.0], [3.0, 1.0, 2.0]], [[0.5, 0.4, 0.3], [0.2, 0.2, 0.2]]
            ),
            deck_velocity=jnp.array([0.1, 0.0, 0.0]),
        )
    allocation = allocate(scenario.route(), NODES)
    return over_scaled_time(landing_problem(scenario, allocation), Continuous())


def problem_over_scaled_time(scenario, nodes):
    """The problem of a scenario in the user's units, whatever units a planner solves it in."""
    asked, _ = scenario.problem(nodes)
    return over_scaled_time(canonical(asked), Continuous())


def random_nodes(problem, seed):
    """Random node variables: velocities of m/s, rates of rad/s, and thrusts over the whole range."""
    random = np.random.default_rng(seed)
    states = random.standard_normal((NODES, 13)) * ([1.0] * 3 + [3.0] * 3 + [0.2] * 4 + [2.0] * 3)
    states[:, 6:10] += [1.0, 0.0, 0.0, 0.0]
    states[:, 6:10] /= np.linalg.norm(states[:, 6:10], axis=1, keepdims=True)
    controls, dilation = random.uniform(0.5, 4.0, (NODES, 4)), random.uniform(1.0, 2.0, NODES)
    return problem.join(jnp.asarray(states), jnp.asarray(controls), jnp.asarray(dilation))
