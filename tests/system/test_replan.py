"""Re-plans: from the solution of a similar scenario, whose ends lie off the new boundary."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.corridor import box, connect
from tests.support.rooms import put, room

SAME_COST = 5e-3  # relative; another start may lead to another local optimum of nearly the same cost
FINER = 5e-2  # relative gain of a finer mesh
KEPT_MESH = 3e-3  # relative loss of a kept mesh, measured 1e-3
PLANNER = jaxscp.Planner()

CHANGES = {
    "start back by 1 mm": room(start=(-0.001, 0.0, 1.0)),
    "start forward by 1 mm": room(start=(0.001, 0.0, 1.0)),
    "goal back by 1 mm": room(goal=(6.001, 1.0, 1.0)),
    "goal away by 1 m": room(goal=(6.7, 1.7, 1.2)),
    "start away by 1 m": room(start=(-0.9, 0.5, 1.0)),
    "heading by -0.2 degrees": room(yaw=-0.003),
    "heading by 90 degrees": room(yaw=np.pi / 2),
    "heading by almost a turn": room(yaw=6.2802),
}


@pytest.fixture(scope="module")
def plan():
    return PLANNER(room())


def assert_replans(plan, scenario):
    fresh, again = PLANNER(scenario), PLANNER.replan(plan, scenario)
    assert jaxscp.status_names(fresh.status) == "converged"
    assert jaxscp.status_names(again.status) == "converged"
    np.testing.assert_allclose(float(again.cost), float(fresh.cost), rtol=SAME_COST)


@pytest.mark.nightly
@pytest.mark.parametrize("scenario", CHANGES.values(), ids=CHANGES)
def test_a_plan_off_its_ends_returns_to_them(plan, scenario):
    assert_replans(plan, scenario)


@pytest.mark.nightly
def test_a_plan_from_a_file_replans_alike(plan, tmp_path):
    scenario = CHANGES["goal away by 1 m"]
    plan.save(tmp_path / "plan.npz", scenario)
    found = jaxscp.Solution.load(tmp_path / "plan.npz")
    asked = jaxscp.LandingScenario.load(tmp_path / "plan.npz")
    again, expected = PLANNER.replan(found, asked), PLANNER.replan(plan, scenario)
    assert jaxscp.status_names(again.status) == "converged"
    assert jax.tree.structure(again) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(again), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.nightly
@pytest.mark.parametrize("case", ["platform_to_platform", "ascent_to_platform"])
def test_random_ends_replan(case):
    """Either end moved by 1 mm to 0.3 m, and turned by 0.1 to 180 degrees, wherever a fresh plan converges."""
    base = getattr(jaxscp.scenarios, case)()
    plan, random, tried = PLANNER(base), np.random.default_rng(7), 0
    for _ in range(30):
        which = random.choice(["start", "goal"])
        move = random.normal(size=3)
        move *= 10 ** random.uniform(-3.0, np.log10(0.3)) / np.linalg.norm(move)
        yaw = np.radians(10 ** random.uniform(-1.0, np.log10(180.0)))
        end = jaxscp.at_rest(np.asarray(getattr(base, which).position) + move, yaw)
        scenario = eqx.tree_at(lambda s, which=which: getattr(s, which), base, end)
        try:
            fresh = PLANNER(scenario)
        except jaxscp.InvalidScenario:  # moved out of the corridor
            continue
        if jaxscp.status_names(fresh.status) == "converged":
            tried += 1
            assert jaxscp.status_names(PLANNER.replan(plan, scenario).status) == "converged"
    assert tried >= 15


@pytest.mark.slow
def test_in_flight_the_mesh_is_kept_at_little_cost():
    """The same re-plan on a free mesh, from the one in flight, is no dearer, and hardly cheaper."""
    scenario, planner, seconds = jaxscp.scenarios.platform_to_platform(), jaxscp.Planner(nodes=30), 0.2
    plan = planner(scenario)
    state = plan.trajectory.at(jnp.array([seconds])).state[0]
    here = dataclasses.replace(scenario, start=jaxscp.BodyState.of(state))
    in_flight = planner.replan(plan, here, seconds)
    free = planner.replan(in_flight, here)
    for found in (in_flight, free):
        assert jaxscp.status_names(found.status) == "converged"
    assert float(free.cost) < float(in_flight.cost) < (1.0 + KEPT_MESH) * float(free.cost)


@pytest.mark.slow
def test_the_rest_of_a_plan_costs_no_more():
    """From states on the plan itself, again and again; a rest has as many nodes as the whole, so a finer mesh."""
    base = jaxscp.scenarios.platform_to_platform()
    plan, spent, tick = PLANNER(base), 0.0, 0.4
    whole = float(plan.cost)
    while float(plan.final_time) > 3.0 * tick:
        state = np.asarray(plan.trajectory.at(jnp.array([tick])).state[0])
        spent += effort(plan.trajectory, tick)
        plan = PLANNER.replan(plan, starting_at(base, state), tick)
        assert jaxscp.status_names(plan.status) == "converged"
        assert not bool(plan.fell_back)
        total = spent + float(plan.cost)
        assert (1.0 - FINER) * whole < total < (1.0 + SAME_COST) * whole
    assert spent > 0.5 * whole


MEASURED = {
    "behind a wall": ([-1.02, 0.0, 1.0], [0.0, 0.0, 0.0]),
    "behind a wall, on the way out": ([-1.01, 0.0, 1.0], [-0.05, 0.0, 0.0]),
    "under the floor, in flight": ([1.0, 0.0, -0.01], [1.0, 0.0, 0.0]),
    "in a corner": ([-1.01, -5.01, 4.9], [0.0, 0.0, 0.0]),
}
NO_FURTHER = 5e-3  # m beyond the start: it may brake first


@pytest.mark.nightly
@pytest.mark.parametrize("case", MEASURED)
def test_a_measured_start_outside_of_a_wall_comes_back(plan, case):
    position, velocity = map(np.array, MEASURED[case])
    scenario = put(put(room(), lambda s: s.start.position, position), lambda s: s.start.velocity, velocity)
    with pytest.raises(jaxscp.InvalidScenario, match=r"start\.position"):
        PLANNER(scenario)
    again = PLANNER.replan(plan, scenario)
    assert jaxscp.status_names(again.status) == "converged"
    assert bool(again.recovers)
    assert "starts outside of a wall" in again.report()
    times = np.asarray(again.trajectory.time)
    path = again.trajectory.at(jnp.linspace(0.0, times[-1], 500))
    corridor = scenario.corridor
    beyond = np.max(
        np.asarray(path.state[:, :3]) @ np.asarray(corridor.normals[0]).T - np.asarray(corridor.offsets[0]),
        axis=1,
    )
    assert beyond.max() < beyond[0] + NO_FURTHER
    assert (beyond[np.linspace(0.0, times[-1], 500) > times[4]] < 1e-3).all()


@pytest.mark.nightly
def test_a_measured_start_beyond_a_limit_comes_back():
    limited = dataclasses.replace(room(), limits=jaxscp.flight_limits(speed=2.0))
    plan = PLANNER(limited)
    fast = put(limited, lambda s: s.start.velocity, [2.1, 0.0, 0.0])
    again = PLANNER.replan(plan, fast)
    assert jaxscp.status_names(again.status) == "converged"
    assert bool(again.recovers)
    speed = np.linalg.norm(np.asarray(again.trajectory.state)[:, 3:6], axis=1)
    assert (speed[4:] < 2.0 + 1e-3).all()


TICK = 0.1  # s


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore:corridor")  # some boxes are narrower than the vehicle
@pytest.mark.parametrize("number", [0, 7, 9])
def test_a_replan_from_a_state_of_its_plan_converges(number):
    """To the end of a flight with sharp turns. Little may be left of a leg, and of the time."""
    from benchmarks.robustness.chains import chain

    scenario = chain(number).scenario
    plan, replans = PLANNER(scenario), 0
    while float(plan.final_time) > 2.0 * TICK and replans < 40:
        state = np.asarray(plan.trajectory.at(jnp.array([TICK])).state[0])
        plan = PLANNER.replan(plan, starting_at(scenario, state), TICK)
        assert jaxscp.status_names(plan.status) == "converged"
        replans += 1
    assert replans > 3


@pytest.mark.nightly
def test_a_replan_near_a_gate_passes_it():
    """The way over joint and gate changes its order there. The gate was once left out by 0.45 m, and converged."""
    rooms = connect([box([0, 0, 0], [5, 2, 2]), box([4, 0, 0], [9, 2, 2])], joints=[[4.2, 0.3, 1.0]])
    ends = jaxscp.at_rest([1.0, 0.3, 1.0]), jaxscp.at_rest([8.0, 0.3, 1.0])
    gates, limits = jaxscp.ellipsoids([[4.8, 1.8, 1.0]], 0.1), jaxscp.flight_limits(speed=1.0)
    scenario = jaxscp.scenarios.through(rooms, *ends, gates=gates, limits=limits)
    plan = PLANNER(scenario)
    state = np.asarray(plan.trajectory.at(jnp.array([3.36])).state[0])
    again = PLANNER.replan(plan, starting_at(scenario, state), 3.36)
    assert jaxscp.status_names(again.status) == "converged"
    away = np.linalg.norm(
        np.asarray(again.trajectory.sample(rate=400.0).state)[:, :3] - [4.8, 1.8, 1.0], axis=1
    )
    assert away.min() < 0.101  # m: the gate's radius, and a millimetre


def effort(trajectory, end):
    """Control effort of the first seconds: the cost without a weight of time."""
    times = jnp.linspace(0.0, end, 200)
    thrusts = jax.vmap(trajectory.control_at)(times)
    return float(jnp.trapezoid(jnp.linalg.norm(thrusts, axis=1), times))


def starting_at(scenario, state):
    parts = state[:3], state[3:6], state[6:10] / np.linalg.norm(state[6:10]), state[10:]
    return eqx.tree_at(
        lambda s: (s.start.position, s.start.velocity, s.start.attitude, s.start.body_rate),
        scenario,
        tuple(map(jnp.asarray, parts)),
    )


def through_another_corridor(mass):
    """Another scenario than the room: its plan is a poor start."""
    return eqx.tree_at(lambda s: s.airframe.body.mass, jaxscp.scenarios.platform_to_platform(), mass)


@pytest.mark.slow
def test_an_infeasible_replan_is_the_earlier_plans():
    """Neither start leads to a solution: the re-plan's own status is reported."""
    impossible = put(room(), lambda s: s.dilation_max, 0.6)  # s, for 6 m
    again = PLANNER.replan(PLANNER(room()), impossible)
    assert jaxscp.status_names(again.status) != "converged"
    assert not bool(again.fell_back)


@pytest.mark.nightly
def test_replans_of_a_batch_have_derivatives(plan):
    """The same as one by one, in value and derivative."""
    masses = jnp.array([1.0, 1.1])
    plans = [plan, PLANNER(through_another_corridor(1.0))]
    both = jax.tree.map(lambda *v: jnp.stack(v), *plans)

    def cost(plan, mass):
        found = PLANNER.replan(plan, through_another_corridor(mass))
        return found.cost

    slope = jax.value_and_grad(cost, 1)
    costs, slopes = jax.vmap(slope)(both, masses)
    for i, one in enumerate(plans):
        value, derivative = slope(one, masses[i])
        np.testing.assert_allclose(costs[i], value, rtol=1e-8)  # the optimum is found to rounding
        np.testing.assert_allclose(slopes[i], derivative, rtol=1e-6)


@pytest.mark.nightly
def test_residuals_of_the_ends_count():
    """A trajectory whose dynamics hold, but whose start does not, is neither feasible nor free of merit."""
    from jaxscp.transcription.lagrangian import Merit, no_multipliers, residual
    from jaxscp.transcription.shooting import Grid, evaluate
    from tests.support.flights import random_nodes, short_problem

    problem = short_problem()
    z = random_nodes(problem, 0)
    found = residual(problem, z, evaluate(problem, z, Grid()))
    closed = eqx.tree_at(lambda r: (r.initial, r.final), found, (0.0 * found.initial, 0.0 * found.final))
    merit = Merit(problem, no_multipliers(problem, z, Grid()), 10.0, jnp.ones(13))
    assert float(found.dynamics) > float(closed.dynamics)
    assert float(merit(found)) > float(merit(closed))


@pytest.mark.nightly
def test_in_flight_a_moving_deck_is_where_it_has_moved_to():
    """The rest of a plan lands where and when the plan does; from the old goal it would land beside the deck."""
    scenario, elapsed = dataclasses.replace(room(), deck_velocity=jnp.array([0.3, 0.1, 0.0])), 0.5
    plan = PLANNER(scenario)
    measured = jaxscp.BodyState.of(plan.trajectory.at(jnp.array([elapsed])).state[0])
    rest = PLANNER.replan(plan, dataclasses.replace(scenario.after(elapsed), start=measured), elapsed)
    assert jaxscp.status_names(rest.status) == "converged"
    total = elapsed + float(rest.final_time)
    np.testing.assert_allclose(
        rest.trajectory.state[-1], scenario.goal_at(jnp.array(total)).vector(), atol=2e-3
    )
    np.testing.assert_allclose(total, float(plan.final_time), rtol=FINER)
