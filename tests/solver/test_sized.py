"""Sizes are those of the solution: a guess far off, a limit that stands for none, and odd units change no answer."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp as js

NODES = 20
OPTIMUM = 12.0  # of the integral of u^2, for one metre in one second from rest to rest: 12 d^2 / T^3
EXACT = 1e-5  # of a cubic, which the nodes represent
TIME = 1e-4  # relative: a switch of the control lies within an interval


def _effort(x, u, t, p):
    return u @ u


def _final_time(x, t, p):
    return t


def _problem(constraints=(), way=1.0, time=None, cost=None):
    return js.OptimalControlProblem(
        dynamics=js.DoubleIntegrator(1),
        cost=js.Cost(running=_effort) if cost is None else cost,
        boundary=js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state([way, 0.0])),
        time=js.Time(NODES, js.FixedTime(1.0)) if time is None else time,
        constraints=constraints,
    )


def _within(lower, upper):
    return _problem((js.bounds(control=(lower, upper)),))


def _far_guess(problem, size=1e6):
    line = jnp.linspace(0.0, size, NODES)
    return dataclasses.replace(js.straight_line(problem), state=jnp.stack([line, line], axis=1))


def _ends_at(solution, way):
    assert js.status_names(solution.status) == "converged"
    samples = solution.trajectory.at([float(solution.final_time)])
    np.testing.assert_allclose(samples.state[0], [way, 0.0], atol=1e-3 * way)


@pytest.mark.parametrize(
    "limits",
    [(-7.0, 7.0), (-1e6, 1e6), (-1e8, 1e8), (-7.0, 1e7)],
    ids=lambda pair: f"{pair[0]:g} to {pair[1]:g}",
)
def test_a_large_limit_that_stands_for_none_changes_nothing(limits):
    problem = _within(*limits)
    solution = js.solve(problem, js.straight_line(problem))
    _ends_at(solution, 1.0)
    np.testing.assert_allclose(solution.cost, OPTIMUM, rtol=EXACT)


@pytest.mark.parametrize("size", [1e2, 1e4, 1e6])
def test_a_guess_that_is_far_off_changes_nothing(size):
    problem = _within(-7.0, 7.0)
    solution = js.solve(problem, _far_guess(problem, size))
    _ends_at(solution, 1.0)
    np.testing.assert_allclose(solution.cost, OPTIMUM, rtol=EXACT)


def test_a_guess_that_is_far_off_hides_no_contradiction():
    """The way needs an acceleration of four."""
    problem = _within(-3.9, 3.9)
    solution = js.solve(problem, _far_guess(problem))
    assert js.status_names(solution.status) != "converged"


@pytest.mark.slow
def test_a_batch_of_sizes_is_a_loop():
    solve = lambda upper, size: js.solve(_within(-upper, upper), _far_guess(_within(-7.0, 7.0), size))  # noqa: E731
    uppers, sizes = jnp.array([7.0, 1e6, 7.0]), jnp.array([1.0, 1.0, 1e6])
    batch = jax.jit(jax.vmap(solve))(uppers, sizes)
    np.testing.assert_allclose(batch.cost, OPTIMUM, rtol=EXACT)
    slopes = jax.jit(jax.vmap(jax.grad(lambda upper, size: solve(upper, size).cost)))(jnp.full(3, 5.5), sizes)
    step = 1e-4
    by_difference = (solve(5.5 + step, 1.0).cost - solve(5.5 - step, 1.0).cost) / (2.0 * step)
    np.testing.assert_allclose(slopes, by_difference, rtol=1e-3)


@pytest.mark.slow
def test_a_slow_flight_costs_what_it_must():
    """The barrier of the guess's own cost would be several times the optimum."""
    time = 150.0
    limits = (js.bounds(state=([-9.0, -2.0 / time], [9.0, 2.0 / time])),)
    problem = _problem(limits, time=js.Time(NODES, js.FixedTime(time)))
    solution = js.solve(problem, js.straight_line(problem))
    _ends_at(solution, 1.0)
    np.testing.assert_allclose(solution.cost, OPTIMUM / time**3, rtol=1e-4)


def _slow(x, u, t, limit):
    return jnp.stack([limit**2 - x[2:] @ x[2:]])


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0.2, 1e-2, 1e-4])
def test_a_direction_that_is_not_used_has_no_say_in_the_cost(limit):
    """A control of size one there would let the barrier be far larger than the cost."""
    time = 1.5 / limit
    problem = js.OptimalControlProblem(
        dynamics=js.DoubleIntegrator(2),
        cost=js.Cost(running=_effort),
        boundary=js.Boundary(js.fixed_state([0.0] * 4), js.fixed_state([1.0, 0.0, 0.0, 0.0])),
        time=js.Time(NODES, js.FixedTime(time)),
        constraints=(js.Constraint(_slow, js.NonNegative(), limit, convex=True),),
    )
    solution = js.solve(problem, js.straight_line(problem))
    assert js.status_names(solution.status) == "converged"
    np.testing.assert_allclose(solution.cost, OPTIMUM / time**3, rtol=1e-5)


def _fastest(way, limit, guess):
    time = js.Time(NODES, js.FreeTime(1e-3 * guess, 1e3 * guess))
    problem = _problem((limit,), way, time, js.Cost(terminal=_final_time))
    return js.solve(problem, js.straight_line(problem, guess))


def _squared_limit(x, u, t, limit):
    return jnp.stack([limit**2 - u @ u])


@pytest.mark.slow
def test_a_limit_without_slope_at_the_guess_holds():
    """The slope of u^2 is zero at the guess."""
    limit = js.Constraint(_squared_limit, js.NonNegative(), 1e-4)
    solution = _fastest(1e-4, limit, 3.0)
    _ends_at(solution, 1e-4)
    np.testing.assert_allclose(solution.final_time, 2.0, rtol=TIME)
    assert jnp.max(jnp.abs(solution.trajectory.control)) <= 1e-4 * (1.0 + 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("way", "limit"), [(1e11, 1e-4), (1e-9, 100.0), (1e6, 1e-4)])
def test_variables_of_far_different_sizes(way, limit):
    """As of an orbit in metres, whose thrust is fifteen decades smaller."""
    fastest = 2.0 * np.sqrt(way / limit)
    solution = _fastest(way, js.bounds(control=(-limit, limit)), 1.5 * fastest)
    _ends_at(solution, way)
    np.testing.assert_allclose(solution.final_time, fastest, rtol=TIME)
    assert jnp.max(jnp.abs(solution.trajectory.control)) <= limit * (1.0 + 1e-3)


def _outside(x, u, t, disc):
    return jnp.stack([(x - disc[:2]) @ (x - disc[:2]) - disc[2] ** 2])


def _around(way, radius):
    ends = js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state([way, 0.0]))
    disc = jnp.array([0.5 * way, 0.02 * radius, radius])
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(lambda x, u, t, p: u, states=2, controls=2),
        cost=js.Cost(running=_effort),
        boundary=ends,
        time=js.Time(NODES, js.FixedTime(1.0)),
        constraints=(js.Constraint(_outside, js.NonNegative(), disc),),
    )


@pytest.mark.slow
def test_a_small_disc_far_along_is_no_smaller_for_the_certificate():
    """A squared distance changes most at the ends: by its slope there, the disc would be within the tolerance."""
    problem = _around(1e4, 50.0)
    solution = js.solve(problem, js.straight_line(problem))
    samples = solution.trajectory.sample(rate=20_000.0).state
    nearest = jnp.min(jnp.linalg.norm(samples - jnp.array([5e3, 1.0]), axis=1))
    converged = js.status_names(solution.status) == "converged"
    assert converged == bool(nearest > 50.0 - 10.0)  # a thousandth of the way
    assert (
        js.status_names(js.solve(_around(6.0, 1.0), js.straight_line(_around(6.0, 1.0))).status)
        == "converged"
    )


def _slow_enough(x, u, t, p):
    return jnp.stack([p - x[1]])


@pytest.mark.slow
@pytest.mark.parametrize("weight", [1e3, 1e5, 1e7])
def test_a_slack_earns_nothing(weight):
    """A soft limit that is not needed costs nothing; one that is, as much as a hard one."""
    for limit, least in ((2.4, OPTIMUM), (1.4, 12.196)):
        soft = js.Constraint(_slow_enough, js.NonNegative(), limit, soft=weight)
        problem = _problem((soft,))
        solution = js.solve(problem, js.straight_line(problem))
        assert js.status_names(solution.status) == "converged"
        np.testing.assert_allclose(solution.cost, least, rtol=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"soft": jnp.inf}, "soft, the weight, must not be negative or infinite"),
        ({"active": [False] * (NODES - 1) + [True]}, r"Pass where=AtNodes\(\)"),
        ({"active": jnp.ones(NODES)}, "expected flags of shape"),
    ],
    ids=["infinite weight", "last node", "numbers as flags"],
)
@pytest.mark.usefixtures("no_type_checks")
def test_constraints_that_hold_nowhere_or_without_end_are_refused(change, message):
    limit = js.Constraint(_slow_enough, js.NonNegative(), 1.4)
    problem = _problem((dataclasses.replace(limit, **change),))
    with pytest.raises(js.InvalidProblem, match=message):
        js.solve(problem, js.straight_line(problem))


@pytest.mark.usefixtures("no_type_checks")
def test_flags_are_no_numbers():
    with pytest.raises(js.InvalidProblem, match="expected flags"):
        js.Constraint(_slow_enough, js.NonNegative(), 1.4, active=[float("nan")] * NODES)


def test_a_limit_that_is_traced_may_be_infinite():
    slope = jax.vmap(
        lambda upper: js.bounds(control=(-1.0, upper)).value(jnp.zeros(2), jnp.zeros(1), 0.0, ())
    )
    np.testing.assert_array_equal(slope(jnp.array([3.0, jnp.inf])), [[1.0, 3.0], [1.0, 1.0]])
