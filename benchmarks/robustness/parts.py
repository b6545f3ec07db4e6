"""The parts of the benchmark: each a function (count, seed, echo) -> figures."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxscp
from benchmarks.robustness.chains import chain, vehicle
from benchmarks.robustness.judge import refuted
from jaxscp.dynamics.rotations import from_yaw, multiply
from jaxscp.landing.units import Units, in_units
from tests.support.rooms import room
from tests.system.test_binding_limits import ALL, SPEEDS, TILTS, limited

Echo = Callable[[str], None]
PLANNER = jaxscp.Planner()
MASSES = np.geomspace(0.03, 200.0, 10)  # kg
ROUTES = (0.3, 3.0, 30.0, 300.0)  # m
LOAD, LONGEST = 2.2, 120.0  # full thrust over weight, and s
MOVES = (1e-3, 1e-2, 0.1, 1.0)  # m, of the start
TURNS = (0.1, 10.0, 90.0, 180.0)  # degrees, of the start's heading
TICK, NOISE = 0.1, 0.01  # s and m: the receding horizon
MOST_TICKS = 200
GAP = 0.01  # of the cost, over the best of three guesses


def _share(flags: list[bool]) -> float:
    return float(np.mean(flags)) if flags else float("nan")


def _converged(solution: jaxscp.Solution) -> bool:
    return bool(solution.status == jaxscp.Status.converged)


def chains(count: int, seed: int, echo: Echo, boxes: int | None = None) -> dict[str, Any]:
    """Plans of random chains, judged by SciPy; costs against two other guesses."""
    PLANNER(chain(seed, boxes).scenario)
    converged, wrong, times, gaps, compared = [], 0, [], [], []
    for number in range(seed, seed + count):
        scenario = chain(number, boxes).scenario
        began = time.perf_counter()
        solution = PLANNER(scenario)
        solution.cost.block_until_ready()
        times.append(time.perf_counter() - began)
        converged.append(_converged(solution))
        if not converged[-1]:
            echo(
                f"chain {number}: {jaxscp.status_names(solution.status)}, {int(solution.iterations)} subproblems"
            )
            continue
        if fault := refuted(scenario, solution):
            wrong += 1
            echo(f"chain {number}: refuted: {fault}")
        others = _costs_from_other_guesses(scenario)
        compared += [cost < float("inf") for cost in others]
        gaps.append(float(solution.cost) / min(float(solution.cost), *others) - 1.0)
        if gaps[-1] > GAP:
            echo(f"chain {number}: {100.0 * gaps[-1]:.2g} % above the best of three guesses")
    return {
        "chains_converged_share": _share(converged),
        "chains_refuted": wrong,
        "chains_p95_over_median": float(np.percentile(times, 95) / np.median(times)),
        "chains_near_optimal_share": _share([gap <= GAP for gap in gaps]),
        "chains_cost_gap_p99": float(np.percentile(gaps, 99)) if gaps else float("nan"),
        "chains_other_guesses_converged_share": _share(compared),
    }


def chains_of_four(count: int, seed: int, echo: Echo) -> dict[str, Any]:
    """The same for chains of four boxes."""
    return {f"four_{name}": value for name, value in chains(count, seed, echo, boxes=4).items()}


def _costs_from_other_guesses(scenario: jaxscp.LandingScenario) -> list[float]:
    """Costs of solves from two other flight times; infinite where one does not converge."""
    problem, context = scenario.problem(PLANNER.nodes_for(scenario))
    guess, costs = scenario.guess(problem, context), []
    for factor in (0.7, 1.5):
        other = dataclasses.replace(guess, time=factor * guess.time, dilation=factor * guess.dilation)
        found = jaxscp.solve(problem, other)
        costs.append(float(found.cost) if _converged(found) else float("inf"))
    return costs


def limits(count: int, seed: int, echo: Echo) -> dict[str, Any]:
    """Plans under limits that bind for long: optima with derivatives."""
    found = []
    for case in (*SPEEDS, *TILTS, *ALL):
        solution = PLANNER(limited(case))
        found.append(_converged(solution) and bool(solution.differentiable))
        if not found[-1]:
            echo(f"limits {case}: {jaxscp.status_names(solution.status)}")
    return {"limits_optimal_share": _share(found)}


def vehicles(count: int, seed: int, echo: Echo) -> dict[str, Any]:
    """Vehicles from 30 g to 200 kg on routes from 0.3 to 300 m in an empty room."""
    found = []
    for mass in MASSES:
        for route in ROUTES:
            scenario = room(
                goal=(route, route / 6.0, 1.0), upper=(2.0 * route + 5.0, route + 5.0, route + 5.0)
            )
            longest = jnp.asarray(LONGEST)
            scenario = dataclasses.replace(scenario, airframe=vehicle(mass, LOAD), dilation_max=longest)
            solution = PLANNER(scenario)
            found.append(_converged(solution))
            if not found[-1]:
                echo(f"{mass:.3g} kg over {route} m: {jaxscp.status_names(solution.status)}")
    return {"vehicles_converged_share": _share(found)}


def units(count: int, seed: int, echo: Echo) -> dict[str, Any]:
    """Case 2 in other units, elsewhere and turned: largest relative difference of the cost."""
    scene, worst = jaxscp.scenarios.ascent_to_platform(), 0.0
    expected = PLANNER(scene)
    one = {"origin": jnp.zeros(3), "turn": jnp.array([1.0, 0, 0, 0]), "length": 1.0, "time": 1.0, "mass": 1.0}
    changes: list[dict[str, Any]] = [{"origin": jnp.array([v, -v, v])} for v in (1e3, 1e5, 1e7)]
    changes += [{"turn": from_yaw(jnp.asarray(a))} for a in (-1.0, 2.0, 3.0)]
    changes += [{name: v} for name in ("length", "mass", "time") for v in (1e-3, 1e-1, 1e2, 1e3)]
    changes += [{"cost": v} for v in (1e-6, 1e-3, 1e3, 1e6)]
    for change in changes:
        by = Units(**{k: jnp.asarray(v, float) for k, v in ({"cost": 1.0} | one | change).items()})
        found = PLANNER(in_units(scene, by))
        difference = abs(float(found.cost * by.cost / expected.cost) - 1.0)
        worst = max(worst, difference)
        if difference > 1e-6 or not _converged(found):
            echo(f"units {change}: {jaxscp.status_names(found.status)}, cost differs by {difference:.1e}")
    return {"invariance_worst": worst}


def replans(count: int, seed: int, echo: Echo) -> dict[str, Any]:
    """Re-plans after moves and turns of the start, where a fresh plan converges."""
    random, failed, tried = np.random.default_rng([seed, 43]), 0, 0
    for number in range(count):
        base = chain(seed + number % 20).scenario
        plan = PLANNER(base)
        scenario = _moved(base, random, number)
        if not (_converged(plan) and _converged(PLANNER(scenario))):
            continue
        tried += 1
        again = PLANNER.replan(plan, scenario)
        if not _converged(again):
            failed += 1
            echo(f"re-plan {number}: {jaxscp.status_names(again.status)}")
    return {"replan_failed": failed, "replans": tried}


def _moved(base: jaxscp.LandingScenario, random: np.random.Generator, number: int) -> jaxscp.LandingScenario:
    """The start moved inside its polytope, or turned."""
    if number % 2:
        turn = from_yaw(jnp.deg2rad(random.choice(TURNS)))
        return eqx.tree_at(lambda s: s.start.attitude, base, multiply(base.start.attitude, turn))
    way = random.normal(size=3)
    way *= random.choice(MOVES) / np.linalg.norm(way)
    normals, offsets = np.asarray(base.corridor.normals[0]), np.asarray(base.corridor.offsets[0])
    room_left, speed = offsets - normals @ np.asarray(base.start.position), normals @ way
    longest = np.min(np.where(speed > 0, room_left / np.maximum(speed, 1e-12), np.inf))
    way *= min(1.0, 0.9 * longest)
    return eqx.tree_at(lambda s: s.start.position, base, base.start.position + way)


def horizon(count: int, seed: int, echo: Echo) -> dict[str, Any]:
    """Flights through chains by re-plans at 10 Hz, with noise of a centimetre on the measured position."""
    flights = []
    for number in range(max(count // 20, 1)):
        scenario, random = chain(seed + number).scenario, np.random.default_rng([seed, number, 47])
        flights.append(_flight(scenario, random))
        if not flights[-1].arrived:
            echo(f"flight {number}: did not arrive after {flights[-1].plans} plans")
    plans = max(sum(flight.plans for flight in flights), 1)
    return {
        "horizon_arrived_share": _share([flight.arrived for flight in flights]),
        "horizon_plans": plans,
        "replan_fallbacks_share": sum(flight.fell_back for flight in flights) / plans,
        "horizon_recovers_share": sum(flight.recovers for flight in flights) / plans,
        "horizon_kept_share": sum(flight.kept for flight in flights) / plans,
    }


class _Flight(NamedTuple):
    """Whether a flight arrives; and of how many plans some were made anew, began outside, or failed."""

    arrived: bool
    plans: int
    fell_back: int
    recovers: int
    kept: int


def _flight(scenario: jaxscp.LandingScenario, random: np.random.Generator) -> _Flight:
    """A flight: the vehicle is where its plan says, and measured with noise; where no plan is found, it keeps its own.

    The noise may lead where no flight exists: a quickest plan brakes just before a wall.
    """
    plan, age, found = PLANNER(scenario), 0, _Flight(False, 1, 0, 0, 0)
    if not _converged(plan):
        return found
    while found.plans < MOST_TICKS and float(plan.final_time) > (age + 2) * TICK:
        age += 1
        state = np.array(plan.trajectory.at(jnp.array([age * TICK])).state[0])
        noisy = state[:3] + NOISE * random.normal(size=3) / np.sqrt(3.0)
        new = PLANNER.replan(plan, _from(scenario, state, noisy), age * TICK)
        converged = _converged(new)
        found = found._replace(
            plans=found.plans + 1,
            fell_back=found.fell_back + bool(new.fell_back),
            recovers=found.recovers + (converged and bool(new.recovers)),
            kept=found.kept + (not converged),
        )
        plan, age = (new, 0) if converged else (plan, age)
    return found._replace(arrived=found.plans < MOST_TICKS)


def in_flight(count: int, seed: int, echo: Echo) -> dict[str, Any]:
    """Re-plans of an undisturbed flight, measured with noise: time beside a plan, and cost beside a free mesh.

    Inside ``jit`` the mesh is free.
    """
    free = jax.jit(lambda plan, scenario, seconds: PLANNER.replan(plan, scenario, seconds))
    ratios, losses, fell_back = [], [], []
    for number in range(seed, seed + max(count // 20, 1)):
        scenario, random = chain(number).scenario, np.random.default_rng([number, 47])
        plan = PLANNER(scenario)
        for age in (1, 4, 8):
            state = np.array(plan.trajectory.at(jnp.array([age * TICK])).state[0])
            noisy = state[:3] + NOISE * random.normal(size=3) / np.sqrt(3.0)
            seconds, here = age * TICK, _from(scenario, state, noisy)
            if not _converged(plan) or seconds > 0.8 * float(plan.final_time):
                continue
            again, other = PLANNER.replan(plan, here, seconds), free(plan, here, jnp.asarray(seconds))
            fell_back.append(bool(again.fell_back))
            if _converged(again) and _converged(other):
                losses.append(float(again.cost / other.cost) - 1.0)
            call = lambda plan=plan, here=here, seconds=seconds: PLANNER.replan(plan, here, seconds)  # noqa: E731
            ratios.append(_seconds(call) / _seconds(lambda scenario=scenario: PLANNER(scenario)))
        echo(f"chain {number}: {np.round(ratios[-3:], 2)} of a plan's time")
    return {
        "in_flight_over_plan": float(np.median(ratios)),
        "in_flight_loss_median": float(np.median(losses)),
        "in_flight_loss_worst": float(np.max(losses)),
        "in_flight_fell_back": _share(fell_back),
        "in_flight_replans": len(ratios),
    }


def _seconds(call: Callable[[], jaxscp.Solution]) -> float:
    """Median time of three calls."""
    times = []
    for _ in range(3):
        began = time.perf_counter()
        call().cost.block_until_ready()
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def _from(
    scenario: jaxscp.LandingScenario, state: np.ndarray, position: np.ndarray
) -> jaxscp.LandingScenario:
    """The scenario from a measured state."""
    state = np.concatenate([position, state[3:6], state[6:10] / np.linalg.norm(state[6:10]), state[10:]])
    return dataclasses.replace(scenario, start=jaxscp.BodyState.of(jnp.asarray(state)))
