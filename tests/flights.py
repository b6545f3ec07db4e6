"""Short flights that are nobody's plan: enough to test derivatives and identities on."""

import jax.numpy as jnp
import numpy as np

from jaxscp import scenarios
from jaxscp.allocation import allocate
from jaxscp.landing import landing_problem

NODES = 8


def short_problem():
    scenario = scenarios.platform_to_platform()
    allocation = allocate(scenario.corridor, scenario.start.position, scenario.goal.position, NODES)
    return landing_problem(scenario, allocation)


def random_nodes(problem, seed):
    """Nodes of a lively flight: metres a second, radians a second, and thrusts all over their range."""
    random = np.random.default_rng(seed)
    states = random.standard_normal((NODES, 13)) * ([1.0] * 3 + [3.0] * 3 + [0.2] * 4 + [2.0] * 3)
    states[:, 6:10] += [1.0, 0.0, 0.0, 0.0]
    states[:, 6:10] /= np.linalg.norm(states[:, 6:10], axis=1, keepdims=True)
    controls, dilation = random.uniform(0.5, 4.0, (NODES, 4)), random.uniform(1.0, 2.0, NODES)
    return problem.join(jnp.asarray(states), jnp.asarray(controls), jnp.asarray(dilation))
