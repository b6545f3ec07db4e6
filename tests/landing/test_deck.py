"""A deck that leaves the last polytope before the vehicle can land is warned of; a later one is not."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.corridor import box, connect
from jaxscp.landing.deck import deck_doubts, deck_outside, least_flight_time, leaving_time
from jaxscp.solver import pipeline

ENDS = jaxscp.at_rest([1.0, 2.0, 1.0]), jaxscp.at_rest([10.0, 8.0, 0.9])


def carrier(end=12.0, speed=2.0, **parts):
    """A deck at x = 10 m that moves at 0.3 m/s; the last room ends at x = ``end``, the corridor half a metre before."""
    rooms = [box([0, 0, 0], [6, 4, 3]), box([4, 1, 0], [8, 7, 3]), box([6, 4, 0], [end, 10, 3])]
    corridor = connect(rooms, margin=0.5)
    limits = jaxscp.flight_limits(speed=speed, **parts)
    return jaxscp.scenarios.through(corridor, *ENDS, deck_velocity=[0.3, 0.0, 0.0], limits=limits)


def test_a_deck_that_leaves_too_soon_is_warned_of():
    assert leaving_time(carrier()) == pytest.approx(5.0)
    with pytest.warns(
        UserWarning, match=r"deck_velocity: the deck leaves .* after 5 s, .* takes 5\.89 s or more"
    ):
        jaxscp.validate(carrier())


@pytest.mark.parametrize("scenario", [carrier(end=12.5), carrier(speed=3.0)], ids=["longer", "faster"])
def test_a_deck_that_leaves_later_is_not(scenario):
    jaxscp.validate(scenario)


def test_a_deck_at_rest_never_leaves():
    still = dataclasses.replace(carrier(), deck_velocity=None)
    assert leaving_time(still) == np.inf
    assert list(deck_doubts(still)) == []
    assert deck_outside(still, 1e9) == ""


def test_the_least_time_is_that_of_the_greatest_acceleration():
    """Along 9 m: a = g tan(tilt), first without a limit of speed, then with one, and then from that speed on."""
    room = connect([box([0, 0, 0], [12, 4, 3])])
    scenario = jaxscp.scenarios.through(
        room, jaxscp.at_rest([1.0, 2.0, 1.0]), jaxscp.at_rest([10.0, 2.0, 1.0])
    )
    tilt = np.arctan(1.0 / 9.81)  # 1 m/s^2
    free = dataclasses.replace(scenario, limits=jaxscp.flight_limits(tilt=tilt))
    assert least_flight_time(free) == pytest.approx(2.0 * 3.0)
    slow = dataclasses.replace(scenario, limits=jaxscp.flight_limits(tilt=tilt, speed=2.0))
    assert least_flight_time(slow) == pytest.approx(9.0 / 2.0 + 2.0)
    start = dataclasses.replace(slow.start, velocity=np.array([2.0, 0.0, 0.0]))
    assert least_flight_time(dataclasses.replace(slow, start=start)) == pytest.approx(7.0 / 2.0 + 2.0)


def test_the_distance_outside_grows_with_the_deck():
    assert deck_outside(carrier(), 4.9) == ""
    assert deck_outside(carrier(), 5.98).startswith("at 5.98 s the deck is 0.29 m outside the last polytope")


def test_a_replan_to_the_deck_of_the_plan_is_warned_of(monkeypatch):
    """No program runs: the plan is a line from the start to the deck, and its rest is not taken."""
    scenario = carrier(end=14.0)
    first, last = scenario.start.vector(), scenario.goal_at(jnp.array(8.0)).vector()
    line = np.linspace(np.asarray(first), np.asarray(last), 5)
    plan = jaxscp.Trajectory.from_arrays(np.linspace(0.0, 8.0, 5), line, np.ones((5, 4)))
    replan = jaxscp.Planner(nodes=5).replan
    monkeypatch.setattr(pipeline, "rest_of", _stop)
    with (
        pytest.warns(
            UserWarning, match=r"goal\.position: the deck is where it was .* 2 s ago.* by 0\.6 m since"
        ),
        pytest.raises(StopIteration),
    ):
        replan(plan, scenario, 2.0)
    here = scenario.after(2.0)
    measured = dataclasses.replace(
        scenario, goal=jaxscp.at_rest(scenario.goal.position + np.array([0.61, 0.02, 0.0]))
    )
    for present in (here, measured):
        with pytest.raises(StopIteration):  # without a warning
            replan(plan, present, 2.0)


def _stop(*parts):
    raise StopIteration
