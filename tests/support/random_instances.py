"""Random variations of the two missions, shared by tests and benchmarks."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

import jaxscp
from jaxscp.aot.aot import without_obstacles
from jaxscp.dynamics.rotations import from_yaw

PRICES = (0.0, 5.0)  # time weights w_t of the benchmarks


def random_instances(
    key, count: int, mission: Callable[[], jaxscp.LandingScenario] = jaxscp.scenarios.platform_to_platform
):
    """A batch of missions with random start, goal, headings, mass and thrust limit; all of them feasible.

    Start and goal move by up to 0.4 m sideways and 0.3 m up from their platforms. Each heading varies by up to
    60 degrees; mass and thrust limit vary by 20 %.
    """
    base = mission()

    def one(key):
        keys = jax.random.split(key, 6)
        low, high = jnp.array([-0.4, -0.4, 0.0]), jnp.array([0.4, 0.4, 0.3])
        yaw = jax.random.uniform(keys[2], (2,), minval=-jnp.pi / 3, maxval=jnp.pi / 3)
        return eqx.tree_at(
            lambda s: (
                s.start.position,
                s.goal.position,
                s.start.attitude,
                s.goal.attitude,
                s.airframe.body.mass,
                s.airframe.thrust_max,
            ),
            base,
            (
                base.start.position + jax.random.uniform(keys[0], (3,), minval=low, maxval=high),
                base.goal.position + jax.random.uniform(keys[1], (3,), minval=low, maxval=high),
                from_yaw(yaw[0]),
                from_yaw(yaw[1]),
                base.airframe.body.mass * jax.random.uniform(keys[3], minval=0.8, maxval=1.2),
                base.airframe.thrust_max * jax.random.uniform(keys[4], minval=0.8, maxval=1.2),
            ),
        )

    return jax.vmap(one)(jax.random.split(key, count))


def bare(scenario: jaxscp.LandingScenario, price: float) -> jaxscp.LandingScenario:
    """The scenario with a time weight and without the point cloud, which the solver does not use.

    Without point clouds all scenarios have one shape, and compile once.
    """
    return eqx.tree_at(lambda s: s.weights.time, without_obstacles(scenario), jnp.asarray(price))
