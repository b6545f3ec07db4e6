"""Whether a vehicle can hover, against a linear program; and the messages where it cannot."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import jaxscp
from jaxscp.dynamics import airframes
from jaxscp.landing.hover import can_hover
from tests.support.rooms import put, room


def by_linear_program(airframe) -> bool:
    """Whether thrusts within their limits have the weight along the body's z axis, and no torque."""
    body = airframe.body
    rows = np.concatenate([body.thrust_map[2:3], body.torque_map])
    weight = np.array([-body.mass * body.gravity[2], 0.0, 0.0, 0.0])
    limits = np.stack([airframe.thrust_min, airframe.thrust_max], axis=1)
    return scipy.optimize.linprog(np.zeros(len(limits)), A_eq=rows, b_eq=weight, bounds=limits).status == 0


def vehicle(random) -> airframes.Airframe:
    """A multirotor with limits that often allow no hover: rotors dead, weak, or all on one side."""
    rotors = int(random.integers(3, 9))
    most = random.uniform(0.0, 8.0, rotors) * (random.uniform(size=rotors) > 0.15)
    airframe = airframes.multirotor(
        mass=0.9,
        inertia=[2e-3, 2e-3, 4e-3],
        arm=0.1,
        torque_ratio=0.016,
        thrust_min=0.0,
        thrust_max=5.0,
        rotors=rotors,
        tilt=random.choice([0.0, 0.3]),
    )
    limits = jnp.asarray(most * random.uniform(0.0, 0.3)), jnp.asarray(most)
    return eqx.tree_at(lambda a: (a.thrust_min, a.thrust_max), airframe, limits)


def test_it_agrees_with_a_linear_program():
    random = np.random.default_rng(3)
    vehicles = [jax.tree.map(np.asarray, vehicle(random)) for _ in range(200)]
    expected = [by_linear_program(a) for a in vehicles]
    assert [bool(can_hover(a, np)) for a in vehicles] == expected
    assert 20 < sum(expected) < 180


SHIPPED = [airframes.paper_mav, airframes.paper_carrier, airframes.crazyflie2, airframes.tilted_quadrotor]


@pytest.mark.parametrize("make", SHIPPED)
def test_shipped_vehicles_hover_and_with_a_dead_rotor_do_not(make):
    airframe = jax.tree.map(np.asarray, make())
    dead = eqx.tree_at(
        lambda a: (a.thrust_min, a.thrust_max),
        airframe,
        [v * [0, 1, 1, 1] for v in (airframe.thrust_min, airframe.thrust_max)],
    )
    assert can_hover(airframe, np)
    assert not can_hover(dead, np)
    assert not jax.jit(lambda a: can_hover(a, jnp))(jax.tree.map(jnp.asarray, dead))


def with_limits(least, most):
    scenario = put(room(), lambda s: s.airframe.thrust_min, least)
    return put(scenario, lambda s: s.airframe.thrust_max, most)


def test_a_dead_rotor_is_an_invalid_scenario_and_an_invalid_element():
    dead = with_limits([0.0, 0.3, 0.3, 0.3], [0.0, 5.0, 5.0, 5.0])
    with pytest.raises(jaxscp.InvalidScenario, match=r"without torque; hover is impossible"):
        jaxscp.validate(dead, 30)
    valid = jax.jit(lambda s: s.valid())
    assert not valid(dead)
    weak = with_limits([0.0, 0.3, 0.3, 0.3], [4.0, 5.0, 5.0, 5.0])
    jaxscp.validate(weak, 30)
    assert valid(weak)


def test_gravity_points_down():
    with pytest.raises(jaxscp.InvalidScenario) as caught:
        jaxscp.validate(put(room(), lambda s: s.airframe.body.gravity, [0.0, 0.0, 9.81]), 30)
    assert "gravity must point along -z" in str(caught.value)
    assert "exceeds the weight" not in str(caught.value)
    jaxscp.validate(put(room(), lambda s: s.airframe.body.gravity, [0.0, 0.0, -1.62]), 30)
