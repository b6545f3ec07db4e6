"""Distances and ranges against each other, and against MuJoCo's own ray caster."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jaxscp.dynamics.airframes import paper_carrier
from jaxscp.simulation import bodies, indoor, simulated_mav

ROUNDING = 1e-9


def test_ranges_are_those_of_mujoco():
    scene = indoor(jax.random.key(3))
    model = bodies.model(simulated_mav(), paper_carrier(), scene)
    data = mujoco.MjData(model)
    data.qpos[[2, 9]] = 500.0  # both vehicles out of sight
    mujoco.mj_forward(model, data)
    origin = np.array([5.0, 1.0, 1.5])
    directions = np.random.default_rng(0).standard_normal((500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hit = np.zeros(1, np.int32)
    expected = [mujoco.mj_ray(model, data, origin, d, None, 1, -1, hit) for d in directions]
    expected = np.where(np.array(expected) < 0.0, np.inf, expected)
    found = np.array(
        jax.jit(jax.vmap(lambda d: scene.range(jnp.asarray(origin), d)))(jnp.asarray(directions))
    )
    inside = (found < 60.0) & np.isfinite(expected)  # MuJoCo's plane ends at 60 m
    np.testing.assert_allclose(found[inside], expected[inside], atol=ROUNDING)
    assert inside.sum() > 150
    assert (found[~np.isfinite(expected)] > 55.0).all()
    ends = origin + found[inside, None] * directions[inside]
    assert np.abs(jax.jit(jax.vmap(scene.distance))(jnp.asarray(ends))).max() < ROUNDING


def test_a_seed_gives_the_same_scene():
    assert (indoor(jax.random.key(1)).centres == indoor(jax.random.key(1)).centres).all()
