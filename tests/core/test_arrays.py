"""Scenarios from concrete and from traced numbers: concrete ones compile nothing, traced ones stay traced."""

import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp import airframes

ROUNDING = 1e-15


def rooms(x):
    boxes = [jaxscp.corridor.box([k, 0.0, x[0]], [k + 1.5, x[1], 3.0]) for k in range(11)]
    wall = jaxscp.corridor.Polytope(jnp.asarray([[0.0, 0.0, 1.0]]), jnp.asarray([2.0]))
    return jaxscp.corridor.connect([*boxes, wall], joints=[[k + 1.2, x[0], x[2]] for k in range(11)])


def vehicle(x):
    return airframes.multirotor(
        mass=x[0],
        inertia=[x[1], 0.02, 0.04],
        arm=x[1],
        torque_ratio=0.1 * x[0],
        thrust_min=0.1,
        thrust_max=x[2],
        rotors=9,
        tilt=x[1],
    )


WRITTEN = {
    "corridor": rooms,
    "vehicle": vehicle,
    "state": lambda x: jaxscp.at_rest([x[0], 1.0, 2.0], x[1]),
    "components": lambda x: jaxscp.fixed(position=x[0], attitude=[1, 1, x[1]]),
    "limits": lambda x: jaxscp.flight_limits(speed=x[0], tilt=0.3),
    "ellipsoids": lambda x: jaxscp.ellipsoids([[0.0, x[0], 1.0]] * 13, x[1]),
    "balls": lambda x: jaxscp.ellipsoids([[0.0, x[0], 1.0]] * 2, [x[1], x[2]]),
}
NUMBERS = [0.5, 0.25, 1.5]


@pytest.mark.parametrize("write", WRITTEN.values(), ids=WRITTEN)
def test_it_is_the_same_when_traced(write):
    known, traced = write(NUMBERS), jax.jit(write)(jnp.asarray(NUMBERS))
    assert jax.tree.structure(known) == jax.tree.structure(traced)
    for a, b in zip(jax.tree.leaves(known), jax.tree.leaves(traced), strict=True):
        assert isinstance(a, jax.Array)
        assert a.dtype == b.dtype == jnp.float64
        np.testing.assert_allclose(a, b, rtol=0, atol=ROUNDING)


def test_what_is_known_is_not_compiled(caplog):
    """No other test makes arrays of these sizes."""
    with jax.log_compiles(), caplog.at_level(logging.DEBUG, "jax"):
        jax.jit(lambda: jnp.zeros(71))()
        assert "Finished XLA compilation" in caplog.text
        caplog.clear()
        for write in WRITTEN.values():
            write(NUMBERS)
        jaxscp.scenarios.ascent_to_platform()
    assert "Finished XLA compilation" not in caplog.text


def test_a_vehicle_has_derivatives():
    """The torque of an upright rotor is proportional to its arm."""

    def of_arm(arm):
        return vehicle([1.0, arm, 5.0]).body.torque_map

    def upright(arm):
        numbers = {
            "mass": 1.0,
            "inertia": [0.1] * 3,
            "torque_ratio": 0.1,
            "thrust_min": 0.0,
            "thrust_max": 1.0,
        }
        return airframes.multirotor(arm=arm, **numbers).body.torque_map

    slope = jax.jacfwd(upright)(0.3)
    np.testing.assert_allclose(jnp.linalg.norm(slope[:2], axis=0), np.ones(4), atol=ROUNDING)
    np.testing.assert_allclose(slope[2], np.zeros(4), atol=ROUNDING)
    step = 1e-6
    difference = (of_arm(0.3 + step) - of_arm(0.3 - step)) / (2 * step)
    np.testing.assert_allclose(jax.jacfwd(of_arm)(0.3), difference, atol=1e-8)
