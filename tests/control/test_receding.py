"""The loop about a planner: plans, starts and ages."""

import types
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.control import HeldPlan, RecedingHorizon, replaced
from tests.support.rooms import room

PERIOD, DEADLINE = 0.5, 0.1
ROUNDING = 1e-12


def plan(speed=1.0, status="converged"):
    """A straight line of two seconds."""
    line = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0, speed], [2 * speed, speed]], [[0.0], [0.0]])
    found = line.with_dynamics(jaxscp.DoubleIntegrator(1))
    return types.SimpleNamespace(trajectory=found, status=getattr(jaxscp.Status, status))


class Planner:
    """Answers with given plans; it notes the requests, and its clock the time of each."""

    def __init__(self, *answers, seconds=0.01):
        self.answers, self.asked, self.seconds, self.now = list(answers), [], seconds, 0.0

    def replan(self, guess, scenario):
        self.asked.append((guess, scenario))
        self.now += self.seconds
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def horizon(self, executor=None):
        timer = lambda: self.now  # noqa: E731
        return RecedingHorizon(self.replan, plan(), PERIOD, DEADLINE, executor, timer)


def test_a_new_plan_begins_where_the_old_one_is_at_the_deadline():
    planner = Planner(plan(2.0))
    horizon = planner.horizon()
    assert horizon.update(0.4, lambda state: state) is horizon.held
    assert not planner.asked
    before = horizon.update(0.5, lambda state: state)
    guess, start = planner.asked[0]
    np.testing.assert_allclose(start, [0.6, 1.0], atol=ROUNDING)
    np.testing.assert_allclose(guess.state[0], [0.6, 1.0], atol=ROUNDING)
    np.testing.assert_allclose(guess.time[-1], 1.4, atol=ROUNDING)
    assert float(before.start) == 0.0  # until the new one begins
    after = horizon.update(0.6, lambda state: state)
    assert float(after.start) == 0.6
    assert horizon.age(0.9) == pytest.approx(0.4)
    assert len(planner.asked) == 1  # the next is due at 1.0 s


@pytest.mark.parametrize(
    ("answer", "seconds", "outcome"),
    [
        (plan(status="verification_failed"), 0.01, "verification_failed"),
        (plan(2.0), 0.2, "late"),
        (jaxscp.InvalidScenario("start: outside the corridor"), 0.01, "failed"),
    ],
)
def test_what_is_not_verified_in_time_is_not_held(answer, seconds, outcome):
    planner = Planner(answer, plan(3.0), seconds=seconds)
    horizon = planner.horizon()
    first = horizon.update(0.5, lambda state: state)
    assert horizon.update(0.7, None) is first
    assert horizon.outcome == outcome
    assert (horizon.error is not None) == (outcome == "failed")
    assert horizon.age(0.7) == pytest.approx(0.7)
    planner.seconds = 0.01
    horizon.update(1.0, lambda state: state)  # the next request is made all the same
    assert float(horizon.update(1.1, None).trajectory.state[0, 1]) == 3.0


def test_a_tick_does_not_wait_for_a_planner_in_another_thread():
    release, planner = Event(), Planner(plan(2.0))

    def slow(guess, scenario):
        release.wait(10.0)
        return planner.replan(guess, scenario)

    with ThreadPoolExecutor(1) as executor:
        horizon = RecedingHorizon(slow, plan(), PERIOD, DEADLINE, executor, lambda: planner.now)
        first = horizon.update(0.5, lambda state: state)
        assert horizon.update(0.55, lambda state: state) is first
        release.set()
        executor.submit(lambda: None).result()  # after the planner
        horizon.update(0.56, None)
        assert float(horizon.update(0.6, None).start) == 0.6


def test_wrong_requests_name_the_field():
    with pytest.raises(ValueError, match="solution: a converged plan"):
        RecedingHorizon(Planner().replan, plan(status="iteration_limit"), PERIOD, DEADLINE)
    with pytest.raises(ValueError, match="deadline"):
        RecedingHorizon(Planner().replan, plan(), PERIOD, 2 * PERIOD)


def test_the_pure_part_chooses_by_the_status():
    old = HeldPlan(plan().trajectory, jnp.zeros(()), jnp.zeros(()))
    new = HeldPlan(plan(2.0).trajectory, jnp.ones(()), jnp.ones(()))
    choose = jax.jit(replaced)
    for status, expected in ((jaxscp.Status.converged, 1.0), (jaxscp.Status.dynamics_unmet, 0.0)):
        held, accepted = choose(old, new, status)
        assert float(held.start) == float(accepted) == expected


@pytest.mark.nightly
def test_a_goal_that_moves_is_reached():
    """In a room, with the library's planner: the goal moves by 0.2 m with every request."""
    planner = jaxscp.Planner(nodes=15)
    solution = planner(room())
    horizon = RecedingHorizon(planner.replan, solution, PERIOD, PERIOD, timer=lambda: 0.0)
    outcomes, goals = [], [(6.0, 1.0 + 0.2 * number, 1.0) for number in range(3)]
    for number in (1, 2):

        def scenario(state, goal=goals[number]):
            start = jaxscp.BodyState.of(state)
            return jaxscp.scenarios.through(room().corridor, start, jaxscp.at_rest(goal))

        horizon.update(0.5 * number, scenario)
        outcomes.append(horizon.outcome)
        held = horizon.update(0.5 * number + 0.5 - 1e-6, None)
    held = horizon.update(1.5, None)
    assert outcomes == ["converged", "converged"]
    np.testing.assert_allclose(held.trajectory.state[-1, :3], goals[2], atol=1e-3)
