"""Thrust and torque maps of the presets, compared with the geometry of the vehicles."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp import airframes

ROUNDING = 1e-12
PRESETS = {
    "paper_mav": (airframes.paper_mav, 0.928, 0.152),
    "paper_carrier": (airframes.paper_carrier, 13.1, 1.068),
    "crazyflie2": (airframes.crazyflie2, 0.027, 0.092),
    "tilted_quadrotor": (airframes.tilted_quadrotor, 0.928, 0.152),
}
presets = pytest.mark.parametrize(("make", "mass", "diagonal"), PRESETS.values(), ids=PRESETS)


@presets
def test_published_mass_and_size(make, mass, diagonal):
    frame = make()
    np.testing.assert_allclose(frame.body.mass, mass)
    np.testing.assert_allclose(2.0 * frame.radius, diagonal)


@presets
def test_hovers_within_its_limits_with_room_to_climb(make, mass, diagonal):
    frame = make()
    hover = np.asarray(frame.body.hover_thrust())
    assert np.all(hover > np.asarray(frame.thrust_min))
    assert np.all(hover < 0.75 * np.asarray(frame.thrust_max))
    lift = frame.body.thrust_map @ hover
    np.testing.assert_allclose(lift, [0.0, 0.0, mass * airframes.GRAVITY], atol=1e-9)
    np.testing.assert_allclose(frame.body.torque_map @ hover, np.zeros(3), atol=1e-9)


@presets
def test_inertia_is_that_of_a_body(make, mass, diagonal):
    """Positive definite, and principal moments obey the triangle inequality."""
    moments = np.linalg.eigvalsh(np.asarray(make().body.inertia))
    assert moments[0] > 0
    assert moments[0] + moments[1] > moments[2]


def test_quadrotor_maps():
    """Upright rotors at 45 + 90 i degrees that spin + - + -."""
    body = airframes.paper_mav().body
    side = 0.076 / np.sqrt(2.0)
    np.testing.assert_allclose(body.thrust_map, [[0] * 4, [0] * 4, [1] * 4], atol=ROUNDING)
    np.testing.assert_allclose(
        body.torque_map,
        [
            [side, side, -side, -side],
            [-side, side, side, -side],
            [0.016, -0.016, 0.016, -0.016],
        ],
        atol=ROUNDING,
    )


@pytest.mark.parametrize("rotors", [4, 6, 8])
@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_torque_is_lever_plus_drag(rotors, tilt):
    arm, ratio = 0.3, 0.02
    body = airframes.multirotor(
        mass=2.0,
        inertia=[0.02, 0.02, 0.04],
        arm=arm,
        torque_ratio=ratio,
        thrust_min=0.0,
        thrust_max=9.0,
        rotors=rotors,
        tilt=tilt,
    ).body
    angle = (np.arange(rotors) + 0.5) * 2.0 * np.pi / rotors
    spin = np.resize([1.0, -1.0], rotors)
    for i in range(rotors):
        position = arm * np.array([np.cos(angle[i]), np.sin(angle[i]), 0.0])
        axis = np.asarray(body.thrust_map[:, i])
        np.testing.assert_allclose(np.linalg.norm(axis), 1.0, atol=ROUNDING)
        np.testing.assert_allclose(axis[2], np.cos(tilt), atol=ROUNDING)
        np.testing.assert_allclose(axis @ position, 0.0, atol=ROUNDING)  # the rotor is tilted about its arm
        torque = np.cross(position, axis) + ratio * spin[i] * axis
        np.testing.assert_allclose(body.torque_map[:, i], torque, atol=ROUNDING)


def test_tilted_rotors_yaw_by_thrust():
    """Tilted rotors have several times the yaw torque of drag alone."""
    upright, tilted = airframes.paper_mav().body, airframes.tilted_quadrotor().body
    assert float(jnp.min(jnp.abs(tilted.torque_map[2] / upright.torque_map[2]))) > 2.0


def test_full_inertia_matrix_is_kept():
    inertia = np.array([[0.02, 1e-3, 0.0], [1e-3, 0.02, 0.0], [0.0, 0.0, 0.04]])
    frame = airframes.multirotor(
        mass=1.0, inertia=inertia, arm=0.2, torque_ratio=0.01, thrust_min=0.0, thrust_max=9.0
    )
    np.testing.assert_array_equal(frame.body.inertia, inertia)
