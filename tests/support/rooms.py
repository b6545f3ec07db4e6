"""Empty rooms, in which plans are quick."""

import equinox as eqx
import jax.numpy as jnp

import jaxscp
from jaxscp.corridor import box, connect


def room(start=(0.0, 0.0, 1.0), goal=(6.0, 1.0, 1.0), upper=(11.0, 5.0, 5.0), yaw=0.0):
    """A room from (-1, -5, 0) to an upper corner, m, and a goal at a heading in radians."""
    corridor = connect([box([-1.0, -5.0, 0.0], list(upper))], joints=[])
    return jaxscp.scenarios.through(corridor, jaxscp.at_rest(start), jaxscp.at_rest(goal, yaw))


def put(scenario, where, value):
    """The scenario with another array."""
    return eqx.tree_at(where, scenario, jnp.asarray(value, jnp.float64))


def with_faces_scaled(scenario, factors):
    """The same polytopes, with normals of other lengths: (faces,) factors."""
    corridor, factors = scenario.corridor, jnp.asarray(factors)
    scaled = put(scenario, lambda s: s.corridor.normals, corridor.normals * factors[:, None])
    return put(scaled, lambda s: s.corridor.offsets, corridor.offsets * factors)
