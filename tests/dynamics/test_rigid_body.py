"""Rigid-body dynamics: closed forms, conservation laws and symmetries."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxscp import airframes
from jaxscp.dynamics import rotations
from jaxscp.dynamics.double_integrator import DoubleIntegrator
from jaxscp.dynamics.rigid_body import RigidBody

ROUNDING = 1e-12

FRAMES = {
    "paper": airframes.paper_mav(),
    "tilted": airframes.tilted_quadrotor(),
    "hexarotor": airframes.multirotor(
        mass=2.0,
        inertia=[[0.02, 1e-3, 0.0], [1e-3, 0.025, -2e-3], [0.0, -2e-3, 0.04]],
        arm=0.3,
        torque_ratio=0.02,
        thrust_min=0.1,
        thrust_max=8.0,
        rotors=6,
        tilt=0.2,
    ),
}
bodies = pytest.mark.parametrize("body", [f.body for f in FRAMES.values()], ids=FRAMES)
rate_of = jax.jit(lambda body, state, control: body(state, control))


def random_state(seed: int) -> jax.Array:
    state = np.random.default_rng(seed).standard_normal(13)
    state[6:10] /= np.linalg.norm(state[6:10])
    return jnp.asarray(state)


def random_thrust(body: RigidBody, seed: int) -> jax.Array:
    return jnp.asarray(np.random.default_rng(seed).uniform(0.5, 3.0, body.control_size))


@bodies
def test_equations_of_motion(body):
    """Equations (1)-(6), written out in NumPy."""
    state, thrust = np.asarray(random_state(1)), np.asarray(random_thrust(body, 2))
    inertia, (w, x, y, z), rate = np.asarray(body.inertia), state[6:10], state[10:13]
    omega = np.array(
        [
            [0.0, -rate[0], -rate[1], -rate[2]],
            [rate[0], 0.0, rate[2], -rate[1]],
            [rate[1], -rate[2], 0.0, rate[0]],
            [rate[2], rate[1], -rate[0], 0.0],
        ]
    )
    turn = np.array(rotations.rotation_matrix(jnp.array([w, x, y, z])))
    force = turn @ np.asarray(body.thrust_map) @ thrust
    torque = np.asarray(body.torque_map) @ thrust - np.cross(rate, inertia @ rate)
    expected = np.concatenate(
        [
            state[3:6],
            force / float(body.mass) + [0.0, 0.0, -9.81],
            0.5 * omega @ state[6:10],
            np.linalg.solve(inertia, torque),
        ]
    )
    np.testing.assert_allclose(rate_of(body, random_state(1), random_thrust(body, 2)), expected, rtol=1e-11)


@bodies
def test_hover_holds_still(body):
    level = jnp.zeros(13).at[6].set(1.0)
    np.testing.assert_allclose(rate_of(body, level, body.hover_thrust()), np.zeros(13), atol=ROUNDING)


@bodies
@pytest.mark.parametrize("yaw", [0.8, -2.0])
def test_turning_the_world_about_the_vertical_turns_the_motion(body, yaw):
    turn = rotations.from_yaw(yaw)
    matrix = rotations.rotation_matrix(turn)

    def turned(state):
        attitude = rotations.multiply(turn, state[6:10])
        return jnp.concatenate([matrix @ state[:3], matrix @ state[3:6], attitude, state[10:]])

    state, thrust = random_state(3), random_thrust(body, 4)
    np.testing.assert_allclose(
        rate_of(body, turned(state), thrust), turned(rate_of(body, state, thrust)), rtol=0, atol=1e-11
    )


@bodies
def test_moving_the_world_changes_nothing(body):
    state, thrust = random_state(5), random_thrust(body, 6)
    moved = state.at[:3].add(jnp.array([7.0, -3.0, 2.0]))
    np.testing.assert_array_equal(rate_of(body, moved, thrust), rate_of(body, state, thrust))


@bodies
def test_free_flight_conserves_energy_and_angular_momentum(body):
    """Without thrust, total energy and angular momentum in world axes are constant, and |q| = 1."""
    idle = jnp.zeros(body.control_size)
    flight = solve_ivp(
        lambda _, y: np.asarray(rate_of(body, jnp.asarray(y), idle)),
        (0.0, 0.5),
        np.asarray(random_state(7)),
        method="DOP853",
        rtol=1e-11,
        atol=1e-11,
    ).y
    before, after = flight[:, 0], flight[:, -1]
    for law in (energy, angular_momentum, attitude_norm):
        np.testing.assert_allclose(law(body, after), law(body, before), rtol=1e-9, atol=1e-11)


def energy(body, state):
    kinetic = 0.5 * body.mass * np.sum(state[3:6] ** 2) + 0.5 * state[10:] @ body.inertia @ state[10:]
    return float(kinetic + body.mass * 9.81 * state[2])


def angular_momentum(body, state):
    return np.asarray(rotations.rotation_matrix(jnp.asarray(state[6:10])) @ (body.inertia @ state[10:]))


def attitude_norm(_, state):
    return np.linalg.norm(state[6:10])


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_double_integrator(dimension):
    system = DoubleIntegrator(dimension)
    state, control = jnp.arange(2.0 * dimension), 10.0 + jnp.arange(1.0 * dimension)
    assert (system.state_size, system.control_size) == (2 * dimension, dimension)
    np.testing.assert_array_equal(system(state, control), jnp.concatenate([state[dimension:], control]))
