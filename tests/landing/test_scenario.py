"""Scenarios in files."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp


def bare():
    return jaxscp.scenarios.platform_to_platform()


def with_everything():
    return dataclasses.replace(
        bare(),
        limits=jaxscp.flight_limits(speed=3.0, tilt=0.5, body_rate=4.0, thrust_rate=20.0),
        keep_out=jaxscp.ellipsoids([[5.0, 0.5, 1.6]], 0.6),
        gates=jaxscp.ellipsoids([[5.0, 0.5, 2.6]], 0.1),
        deck_velocity=jnp.array([0.3, -0.1, 0.1]),
        start_fixed=jaxscp.fixed(velocity=[1, 0, 1]),
        goal_fixed=jaxscp.fixed(attitude=[1, 1, 0]),
    )


def batch():
    return jax.tree.map(lambda v: jnp.stack([v, 2.0 * v]), with_everything())


@pytest.mark.parametrize("make", [bare, with_everything, batch])
def test_a_saved_scenario_is_loaded_bitwise(make, tmp_path):
    scenario = make()
    scenario.save(tmp_path / "scenario.npz")
    found = jaxscp.LandingScenario.load(tmp_path / "scenario.npz")
    assert isinstance(found, jaxscp.LandingScenario)
    assert jax.tree.structure(found) == jax.tree.structure(scenario)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(scenario), strict=True):
        assert np.asarray(one).dtype == np.asarray(other).dtype
        np.testing.assert_array_equal(one, other)


def test_what_holds_no_scenario_says_so(tmp_path):
    file = tmp_path / "scenario.npz"
    bare().save(file)
    with pytest.raises(ValueError, match=r"scenario\.npz: holds no solution"):
        jaxscp.Solution.load(file)
    jaxscp.Trajectory.from_arrays([0.0, 1.0], [[0.0], [1.0]], [[0.0], [0.0]]).save(file)
    with pytest.raises(
        ValueError, match=r"scenario\.npz: not a file that save wrote: it has no 'header', but time"
    ):
        jaxscp.LandingScenario.load(file)


def test_after_some_seconds_the_goal_is_where_the_deck_is():
    scenario, now = with_everything(), 1.5
    later = scenario.after(now)
    for time in (0.0, 2.0):
        here, there = later.goal_at(jnp.array(time)), scenario.goal_at(jnp.array(now + time))
        np.testing.assert_allclose(here.vector(), there.vector(), rtol=0, atol=1e-14)
    same = dataclasses.replace(later, goal=scenario.goal)
    for one, other in zip(*map(jax.tree.leaves, (same, scenario)), strict=True):
        assert one is other


def test_without_a_moving_deck_nothing_is_later():
    scenario = bare()
    assert scenario.after(3.0) is scenario


def test_after_is_pure():
    """Under ``jit`` and ``vmap``; its derivative is the deck's velocity."""
    scenario = with_everything()
    places = jax.jit(jax.vmap(lambda t: scenario.after(t).goal.position))(jnp.array([0.0, 2.0]))
    velocity = np.asarray(scenario.deck_velocity)
    np.testing.assert_allclose(places[1] - places[0], 2.0 * velocity, rtol=0, atol=1e-14)
    slope = jax.jacfwd(lambda t: scenario.after(t).goal.position)(1.0)
    np.testing.assert_array_equal(slope, velocity)


def test_help_has_a_line_for_each_field():
    text = str(jaxscp.LandingScenario.__doc__)
    for field in dataclasses.fields(jaxscp.LandingScenario):
        assert f"\n        {field.name}: " in text, field.name
