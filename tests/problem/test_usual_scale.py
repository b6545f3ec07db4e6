"""Typical sizes of problems that state none, and plans that do not depend on the units."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp as js
from benchmarks.robustness.chains import chain
from jaxscp.problem.canonical import canonical
from jaxscp.problem.usual_scale import usual_scale

TIMES = np.linspace(0.0, 1.4, 15)
MESH = 2e-3  # of paths by different meshes: the switch of the control lies within one interval of either
CLIMB, CLIMB_ERROR = 0.012837, 1e-3  # of the Goddard rocket: Dolan, Moré and Munson, "COPS", 2004; relative


def fastest(length):
    """From rest to rest; the acceleration is limited to two lengths a second squared."""
    return js.OptimalControlProblem(
        dynamics=js.DoubleIntegrator(1),
        cost=js.Cost(terminal=lambda x, t, p: t),
        constraints=(js.bounds(control=(-2.0 * length, 2.0 * length)),),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state([length, 0.0])),
        time=js.Time(nodes=20, final=js.FreeTime(0.1, 10.0)),
    )


def scale_of(problem, final_time=2.0):
    asked = canonical(problem)
    return jax.jit(lambda guess: usual_scale(asked, guess))(js.straight_line(problem, final_time))


def goddard(weight):
    """The highest flight of a rocket with drag, without dimensions; nearly all of the cost is a constant."""

    def rates(x, u, t, p):
        height, speed, mass = x
        drag = 310.0 * speed**2 * jnp.exp(-500.0 * (height - 1.0))
        return jnp.stack([speed, (u[0] - drag) / mass - 1.0 / height**2, -2.0 * u[0]])

    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(rates, states=3, controls=1),
        cost=js.Cost(terminal=lambda x, t, p: -weight * x[0]),
        constraints=(js.bounds(control=(0.0, 3.5), state=([1.0, 0.0, 0.6], [None, None, 1.0])),),
        boundary=js.Boundary(js.fixed_state([1.0, 0.0, 1.0]), js.fixed_state([None, None, 0.6])),
        time=js.Time(nodes=60, final=js.FreeTime(0.05, 1.0)),
    )


def test_sizes_of_about_one_count_as_one():
    scale = scale_of(fastest(3.0))
    assert all(np.all(np.asarray(v) == 1.0) for v in jax.tree.leaves(scale))


def landing(number):
    """A flight through random rooms as a problem, and a guess that lies almost in a plane."""
    scenario = chain(number).scenario
    problem, context = scenario.problem(js.Planner().nodes_for(scenario))
    return problem, scenario.guess(problem, context)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:corridor")  # rooms that are narrow for the vehicle
@pytest.mark.parametrize("number", [30003, 30036, 30337])
def test_rounding_in_a_guess_is_no_size(number):
    """Some components change by 1e-16 along the guess, and so do rates and slopes."""
    problem, guess = landing(number)
    assert np.any((np.ptp(guess.state, axis=0) < 1e-12) & (np.ptp(guess.state, axis=0) > 0.0))
    scale = jax.jit(lambda guess: usual_scale(canonical(problem), guess))(guess)
    assert np.min(scale.state) >= 1e-3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:corridor")
def test_a_landing_is_solved_without_a_scale():
    problem, guess = landing(30003)
    assert js.solve(problem, guess).status == js.Status.converged


@pytest.mark.parametrize("unit", [1e-6, 1e-3, 1e3, 1e6])
def test_sizes_follow_the_unit(unit):
    """Position: its range. Control: its limit. Speed has neither; it is what the control can reach, or must."""
    scale = scale_of(fastest(unit))
    for size in (*scale.state, *scale.control):
        assert unit / 10.0 < size / 1.001 <= 10.0 * unit
    assert scale.cost == 1.0


def test_size_of_the_cost_is_its_change():
    """Not its value, of which most is a constant; and none where nothing moves it."""
    small = scale_of(goddard(1.0), 0.2).cost
    assert 1e-3 < small < 0.3
    np.testing.assert_allclose(scale_of(goddard(1e4), 0.2).cost, 1e4 * small)
    problem = fastest(1.0)
    free = js.OptimalControlProblem(problem.dynamics, js.Cost(), problem.boundary, problem.time)
    assert scale_of(free).cost == 1.0


def test_sizes_have_no_derivatives_and_are_finite_where_rates_are_not():
    def rates(x, u, t, p):
        return jnp.stack([jnp.sqrt(x[0]), u[0] / x[0]])  # at zero: an infinite derivative, and no rate

    base = fastest(1.0)
    odd = js.OptimalControlProblem(
        js.Dynamics.of(rates, states=2, controls=1), base.cost, base.boundary, base.time, base.constraints
    )
    assert all(np.all(np.isfinite(v)) for v in jax.tree.leaves(scale_of(odd)))
    slope = jax.grad(lambda length: scale_of(fastest(length)).state[0])(1e3)
    assert slope == 0.0


@pytest.mark.slow
def test_units_change_no_plan():
    """All by one compiled program; the exact optimum is the square root of two."""
    solver = jax.jit(lambda length: js.solve(fastest(length), js.straight_line(fastest(length), 2.0)))
    plans = {length: solver(length) for length in (1.0, 1e-6, 1e-3, 1e3, 1e6)}
    for length, plan in plans.items():
        assert js.status_names(plan.status) == "converged", length
        np.testing.assert_allclose(plan.final_time, np.sqrt(2.0), rtol=1e-4)
        assert abs(int(plan.iterations) - int(plans[1.0].iterations)) <= 1
        path, same = (p.trajectory.at(TIMES).state for p in (plan, plans[1.0]))
        np.testing.assert_allclose(path / length, same, atol=MESH)


@pytest.mark.slow
def test_a_cost_that_hardly_changes_is_optimal_nevertheless():
    """With the cost's own value as unit, the barrier took two hundredths of the climb."""
    for weight in (1.0, 1e3):
        problem = goddard(weight)
        plan = js.solve(problem, js.straight_line(problem, 0.2))
        assert js.status_names(plan.status) == "converged"
        climb = float(plan.trajectory.state[-1, 0]) - 1.0
        np.testing.assert_allclose(climb, CLIMB, rtol=CLIMB_ERROR)
