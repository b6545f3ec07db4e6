"""Scenarios of one's own: parts by name, and numbers as Python, NumPy and JAX make them."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.landing.scenarios import Parts
from tests.support.rooms import room

CORRIDOR = room().corridor
ENDS = jaxscp.at_rest([0, 0, 1]), jaxscp.at_rest([6, 1, 1])
PARTS = {
    "airframe": jaxscp.airframes.crazyflie2(),
    "weights": jaxscp.Weights(1.0, 5),
    "limits": jaxscp.FlightLimits(speed=3),
    "keep_out": jaxscp.Ellipsoids([[3, 3, 3]], [np.eye(3).tolist()]),
    "gates": jaxscp.ellipsoids([[2, 0, 1]], 0.2),
    "deck_velocity": np.array([0.1, 0, 0]),
    "cone_angle": np.float32(0.7),
    "dilation_max": 10,
}


PLANNER = jaxscp.Planner(nodes=6, method=jaxscp.PTR(max_iterations=1))


def with_mass(mass):
    scenario = jaxscp.scenarios.through(CORRIDOR, *ENDS)
    return eqx.tree_at(lambda s: s.airframe.body.mass, scenario, mass)


@pytest.fixture(scope="module")
def compiled():
    """A compiled planner, and the cost of a vehicle of 1 kg."""
    planner = PLANNER.compile(with_mass(0.9))
    return planner, float(planner(with_mass(jnp.array(1.0))).cost)


def test_parts_are_taken_by_name():
    scenario = jaxscp.scenarios.through(CORRIDOR, *ENDS, **PARTS)
    scenario.check(nodes=10)
    for name, part in PARTS.items():
        for ours, given in zip(*map(jax.tree.leaves, (getattr(scenario, name), part)), strict=True):
            np.testing.assert_array_equal(ours, given)


def test_an_unknown_part_is_refused():
    with pytest.raises(TypeError, match=r"through: unknown colour, vehicle; there are airframe, .*weights"):
        jaxscp.scenarios.through(CORRIDOR, *ENDS, colour="red", vehicle=None)


def test_every_field_of_a_scenario_is_taken_by_name():
    fields = {field.name for field in dataclasses.fields(jaxscp.LandingScenario)}
    assert set(Parts.__annotations__) == fields - {"start", "goal", "corridor", "obstacles"}


@pytest.mark.parametrize(
    "mass", [1, 1.0, np.float64(1.0), np.float32(1.0), np.int64(1), np.array(1.0), jnp.array(1.0)]
)
@pytest.mark.slow
def test_every_kind_of_number_gives_the_same_plan(compiled, mass):
    """Set by ``eqx.tree_at``, past any constructor."""
    planner, expected = compiled
    scenario = with_mass(mass)
    assert float(PLANNER(scenario).cost) == float(planner(scenario).cost) == expected


def test_a_word_for_a_number_is_refused_by_name():
    with pytest.raises(jaxscp.InvalidScenario, match=r"airframe\.body\.mass"):
        PLANNER(with_mass("heavy"))
