"""Physics of the world: conservation, hover, the deck, and C MuJoCo against MJX."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from jaxscp.dynamics.airframes import paper_carrier
from jaxscp.simulation import Aerodynamics, World, bodies, carrier_state, simulated_mav, vehicle_state
from jaxscp.simulation.vehicles import FEET_DEPTH

pytestmark = pytest.mark.slow  # a program of MJX to compile

AGREEMENT = 1e-6
"""m, rad: both compute in float64; a contact solver of 8 iterations amplifies rounding."""
FIRST_ORDER = 1e-3
"""Relative: semi-implicit Euler at 2.5 ms loses energy of rotation to first order."""
STEPS = 400

STILL_AIR = Aerodynamics(rotor_drag=[0.0] * 3, drag_area=0.0, suction=0.0, rotor_radius=1e-6)
WORLD = World.of()


@pytest.fixture(scope="module")
def run():
    """One compiled open-loop flight of 400 steps (1 s), shared by all tests."""

    def flight(world, state, commands):
        def step(state, inputs):
            new = world.step(state, *inputs)
            return new, (vehicle_state(new), carrier_state(new), new.wrenches, new.motion.qpos)

        return jax.lax.scan(step, state, (commands, jax.random.split(jax.random.key(1), STEPS)))

    compiled = eqx.filter_jit(flight)
    return lambda world, state, commands: jax.tree.map(np.asarray, compiled(world, state, commands))


def commands(thrust):
    return jnp.full((STEPS, 4), thrust)


def test_free_flight_keeps_energy_and_momentum(run):
    """No air, no thrust: a parabola; angular momentum in the world and energy of rotation stay."""
    world = eqx.tree_at(lambda w: (w.air, w.motors.thrust_min), WORLD, (STILL_AIR, jnp.zeros(4)))
    state = world.init(jax.random.key(0), height=40.0)
    qvel = state.motion.qvel.at[:6].set(jnp.array([3.0, 1.0, 4.0, 1.0, 2.0, 0.5]))
    state = eqx.tree_at(lambda s: s.motion.qvel, state, qvel)
    _, (vehicle, *_) = run(world, state, commands(0.0))
    time = bodies.TIME_STEP * np.arange(1, STEPS + 1)
    np.testing.assert_allclose(vehicle[:, 5], 4.0 - 9.81 * time, atol=1e-9)
    np.testing.assert_allclose(vehicle[:, 3:5], np.broadcast_to([3.0, 1.0], (STEPS, 2)), atol=1e-9)
    inertia = np.diag([2.5e-3, 2.1e-3, 4.3e-3])
    energy = 0.5 * np.einsum("ti,ij,tj->t", vehicle[:, 10:], inertia, vehicle[:, 10:])
    w, v = vehicle[:, 6:7], vehicle[:, 7:10]
    local = vehicle[:, 10:] @ inertia
    momentum = local + 2.0 * np.cross(v, w * local + np.cross(v, local))
    size = np.linalg.norm(momentum[0])
    assert np.abs(energy / energy[0] - 1.0).max() < 5.0 * FIRST_ORDER
    assert np.abs(momentum - momentum[0]).max() / size < 5.0 * FIRST_ORDER


def test_hover_thrust_holds_the_vehicle(run):
    world = eqx.tree_at(lambda w: w.air, WORLD, STILL_AIR)
    state = world.init(jax.random.key(0), height=40.0)
    hover = 0.928 * 9.81 / 4.0
    ready = (jnp.asarray(np.full(4, hover)), jnp.asarray(np.full((4, 4), hover)))  # as strong types
    state = eqx.tree_at(lambda s: (s.motors.thrusts, s.motors.waiting), state, ready)
    _, (vehicle, *_) = run(world, state, commands(hover))
    # the air's root at zero speed leaves an inflow of a micrometre a second
    np.testing.assert_allclose(vehicle[-1, :3], state.motion.qpos[:3], atol=1e-6)


def test_a_drop_settles_on_the_deck(run):
    _, (vehicle, carrier, *_) = run(WORLD, WORLD.init(jax.random.key(0), height=0.1), commands(0.1))
    last = slice(-40, None)
    height = vehicle[last, 2] - carrier[last, 2] - bodies.DECK_HEIGHT - FEET_DEPTH
    assert np.abs(height).max() < 0.01  # contacts yield by some millimetres
    assert np.abs(vehicle[last, 3:6] - carrier[last, 3:6]).max() < 0.05
    assert np.abs(vehicle[last, 7:9]).max() < 0.02


def test_the_vehicle_rides_on_a_moving_deck_without_slip(run):
    world = eqx.tree_at(lambda w: w.course.velocity, WORLD, jnp.array([1.0, 0.0, 0.0]))
    state = world.init(jax.random.key(0))
    _, (vehicle, carrier, *_) = run(world, state, commands(0.1))
    assert carrier[-1, 0] > 0.8
    assert np.abs((vehicle - carrier)[:, :2]).max() < 0.01


def test_c_and_mjx_fly_the_same(run):
    """The wrenches that MJX's flight applied, played in C: a drop with thrust, drag and contact."""
    state = WORLD.init(jax.random.key(0), height=0.1)
    _, (_, _, applied, expected) = run(WORLD, state, commands(1.0).at[:, 0].add(0.01))
    model = bodies.model(simulated_mav(), paper_carrier())
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = state.motion.qpos, state.motion.qvel
    found = np.empty_like(expected)
    for i, wrench in enumerate(applied):
        data.xfrc_applied[[bodies.VEHICLE, bodies.CARRIER]] = wrench
        mujoco.mj_step(model, data)
        found[i] = data.qpos
    assert np.abs(found - expected).max() < AGREEMENT


@pytest.mark.usefixtures("no_type_checks")
@pytest.mark.parametrize(
    ("name", "vector"),
    [("wind", (np.nan, 0.0, 0.0)), ("wind", (3.0, 0.0)), ("start", 2.0), ("velocity", "east")],
)
def test_vectors_are_three_finite_numbers(name, vector):
    with pytest.raises(ValueError, match=f"{name}: expected three finite numbers"):
        World.of(**{name: vector})


def test_a_vehicle_that_the_world_cannot_hold_is_refused():
    """MuJoCo's model would take earth's gravity and the diagonal of the inertia, and say nothing."""
    mav = simulated_mav()
    moon = eqx.tree_at(lambda a: a.body.gravity, mav, jnp.array([0.0, 0.0, -1.62]))
    with pytest.raises(ValueError, match=r"airframe\.body\.gravity"):
        World.of(airframe=moon)
    skew = eqx.tree_at(lambda a: a.body.inertia, mav, mav.body.inertia.at[0, 1].add(1e-3))
    with pytest.raises(ValueError, match=r"airframe\.body\.inertia"):
        World.of(airframe=skew)
