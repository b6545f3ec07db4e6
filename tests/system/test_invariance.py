"""A scene in other units, at another place or in another direction gives the same plan; all share one compilation."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.dynamics import rotations
from jaxscp.landing.units import Units, in_units, units_of

ACCURACY = 1e-6  # relative; the solver stops at an optimum to about 1e-8
PLANNER = jaxscp.Planner()
HERE, AHEAD = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)


@functools.cache
def scene():
    return jaxscp.scenarios.ascent_to_platform()


@functools.cache
def plan():
    return PLANNER(scene())


def units(*, origin: Any = HERE, turn: Any = AHEAD, length=1.0, time=1.0, mass=1.0, cost=1.0):
    return Units(*(jnp.asarray(v, float) for v in (origin, turn, length, time, mass, cost)))


def check(by, status="converged"):
    """The plan of the scene in other units is the plan of the scene."""
    found = PLANNER(in_units(scene(), by))
    assert jaxscp.status_names(found.status) == status
    assert abs(int(found.iterations) - int(plan().iterations)) <= 1
    np.testing.assert_allclose(found.cost * by.cost, plan().cost, rtol=ACCURACY)
    back = by.trajectory(found.trajectory)
    for name in ("time", "state", "control", "dilation"):
        ours, theirs = getattr(back, name), getattr(plan().trajectory, name)
        np.testing.assert_allclose(ours, theirs, atol=ACCURACY * np.abs(theirs).max(), rtol=0.0, err_msg=name)


def test_units_of_a_typical_scene_are_near_one():
    of = units_of(scene())
    np.testing.assert_array_less(np.abs(np.log([of.length, of.time, of.mass, of.cost])), np.log(2.0))


@pytest.mark.nightly
def test_units_and_back():
    by = units_of(scene())
    path = plan().trajectory.with_dynamics(None)
    back = by.trajectory(by.own_trajectory(path))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-12), back, path)


def test_units_of_a_scene_in_its_own_units_are_one():
    of = units_of(in_units(scene(), units_of(scene())))
    np.testing.assert_allclose([of.length, of.time, of.mass, of.cost], 1.0, rtol=1e-12)
    np.testing.assert_allclose(of.origin, 0.0, atol=1e-12)
    np.testing.assert_allclose(of.turn, AHEAD, atol=1e-12)


def turned(angle):
    return units(turn=rotations.from_yaw(angle))


def in_body_axes(angle):
    """The scene with other body axes: old axes turned about z by an angle."""
    turn = rotations.from_yaw(angle)
    matrix = rotations.rotation_matrix(turn).T
    s, frame, body = scene(), scene().airframe, scene().airframe.body
    body = dataclasses.replace(
        body,
        inertia=matrix @ body.inertia @ matrix.T,
        thrust_map=matrix @ body.thrust_map,
        torque_map=matrix @ body.torque_map,
    )

    def renamed(state):
        attitude = rotations.multiply(state.attitude, turn)
        return dataclasses.replace(state, attitude=attitude, body_rate=matrix @ state.body_rate)

    frame = dataclasses.replace(frame, body=body)
    return dataclasses.replace(s, airframe=frame, start=renamed(s.start), goal=renamed(s.goal))


def with_other_rotors(order):
    """The scene with its rotors in another order."""
    order, frame = np.array(order), scene().airframe
    maps = frame.body.thrust_map[:, order], frame.body.torque_map[:, order]
    body = dataclasses.replace(frame.body, thrust_map=maps[0], torque_map=maps[1])
    least, most = frame.thrust_min[order], frame.thrust_max[order]
    frame = dataclasses.replace(frame, body=body, thrust_min=least, thrust_max=most)
    return dataclasses.replace(scene(), airframe=frame)


def mirrored():
    """The scene's image in the plane y = 0: lengths along y, and turns about x and z, change their signs."""
    flip = jnp.diag(jnp.array([1.0, -1.0, 1.0]))
    s, frame, body = scene(), scene().airframe, scene().airframe.body
    body = dataclasses.replace(
        body,
        inertia=flip @ body.inertia @ flip,
        thrust_map=flip @ body.thrust_map,
        torque_map=-flip @ body.torque_map,
    )

    def image(state):
        attitude = state.attitude * jnp.array([1.0, -1.0, 1.0, -1.0])
        position, velocity = flip @ state.position, flip @ state.velocity
        return type(state)(position, velocity, attitude, -flip @ state.body_rate)

    corridor = s.corridor
    corridor = dataclasses.replace(corridor, normals=corridor.normals @ flip, joints=corridor.joints @ flip)
    frame = dataclasses.replace(frame, body=body)
    return dataclasses.replace(s, airframe=frame, start=image(s.start), goal=image(s.goal), corridor=corridor)


RENAMED = {
    "rotors": (lambda: with_other_rotors([2, 0, 3, 1]), np.ones(3)),
    "body axes": (lambda: in_body_axes(np.pi / 4.0), np.ones(3)),
    "mirror": (mirrored, np.array([1.0, -1.0, 1.0])),
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow if n == "mirror" else pytest.mark.nightly) for n in RENAMED],
)
def test_the_same_path_under_other_names(name):
    changed, signs = RENAMED[name]
    found = PLANNER(changed())
    assert jaxscp.status_names(found.status) == "converged"
    assert abs(int(found.iterations) - int(plan().iterations)) <= 1
    np.testing.assert_allclose(found.cost, plan().cost, rtol=ACCURACY)
    expected = plan().trajectory.state[:, :3] * signs
    np.testing.assert_allclose(found.trajectory.state[:, :3], expected, atol=ACCURACY)


OTHER_UNITS = (
    {f"length {v:g}": units(length=v) for v in (0.1, 30.0, 1e3)}
    | {f"mass {v:g}": units(mass=v) for v in (1e-3, 0.01, 1e3)}
    | {f"time {v:g}": units(time=v) for v in (1e-3, 1e3)}
    | {f"cost {v:g}": units(cost=v) for v in (1e-6, 1e-3, 1e3, 1e6)}
    | {f"far {v:g}": units(origin=[v, -v, v]) for v in (1e3, 1e5, 1e7)}
    | {"on a map": units(origin=[448261.3, 5411932.7, 254.1])}
    | {f"turned {v:g}": turned(v) for v in (-1.0, 0.5, 2.0, np.pi)}
)


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHER_UNITS)
def test_the_same_plan_in_other_units(name):
    check(OTHER_UNITS[name])


@pytest.mark.slow
def test_the_certificate_judges_in_the_users_units():
    """A flight of kilometres that must be true to a millimetre: the same plan, and it is not good enough."""
    check(units(length=1e-3), status="verification_failed")
