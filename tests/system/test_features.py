"""What a problem may hold, each against a closed form."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp as js
from tests.support.own_problems import (
    double_integrator,
    sine_cost,
    single_integrator,
    squared_control,
    time_taken,
)

EXACT = 1e-5  # relative: barrier, and the weight of an even mesh
ENERGY = js.Cost(running=squared_control)


def solved(problem, guess=None, final_time=None):
    solution = js.solve(problem, js.straight_line(problem, final_time) if guess is None else guess)
    assert js.status_names(solution.status) == "converged"
    assert bool(solution.certificate.passed())
    return solution


@pytest.mark.slow
def test_zero_order_hold_is_the_least_squares_solution():
    """Constant forces over ten intervals: the least norm that reaches the goal."""
    solution = solved(double_integrator(ENERGY, js.Time(11, js.FixedTime(2.0)), zero_order_hold=(0,)))
    width, after = 0.2, np.arange(10)[::-1]
    reach = np.array([width**2 * (after + 0.5), np.full(10, width)])
    best = np.linalg.pinv(reach) @ np.array([1.0, 0.0])
    np.testing.assert_allclose(solution.cost, width * best @ best, rtol=EXACT)
    np.testing.assert_allclose(solution.trajectory.control[:-1, 0], best, atol=1e-4)
    held = solution.trajectory.control_at(0.5 * width)
    np.testing.assert_allclose(held, solution.trajectory.control[0])


def slower(x, u, t, limit):
    return limit - x[1:2]


@pytest.mark.nightly
def test_soft_constraint():
    """At a large weight it is kept; at a weight of zero it has no effect; its cost is weight times the integral."""
    problem = double_integrator(ENERGY, js.Time(21, js.FixedTime(2.0)))

    def with_weight(weight):
        limit = js.Constraint(slower, js.NonNegative(), 0.6, convex=True, soft=weight)
        return solved(dataclasses.replace(problem, constraints=(limit,)))

    hard = js.Constraint(slower, js.NonNegative(), 0.6, convex=True)
    kept = solved(dataclasses.replace(problem, constraints=(hard,)))
    np.testing.assert_allclose(
        with_weight(1e3).cost, kept.cost, rtol=2e-3
    )  # margins between nodes cost a little
    between = with_weight(1.0)
    assert 1.5 < float(between.cost) < float(kept.cost)
    assert float(between.trajectory.state[:, 1].max()) > 0.65


@pytest.mark.nightly
def test_final_time_apart_from_the_dilation():
    """The final time keeps its own limits, while the mesh may stretch."""
    time = js.Time(21, js.FreeTime(1.5, 10.0, dilation=(0.05, 20.0)))
    solution = solved(double_integrator(js.Cost(terminal=time_taken), time, limit=2.0), final_time=2.0)
    np.testing.assert_allclose(solution.final_time, 1.5, rtol=EXACT)


@pytest.mark.slow
def test_integral_constraint():
    """The fastest motion at an energy of 1.5 takes 2 s."""
    spends = js.with_integral(js.DoubleIntegrator(1), lambda x, u, t, p: u @ u)
    problem = js.OptimalControlProblem(
        dynamics=spends,
        cost=js.Cost(terminal=time_taken),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0, 0.0]), js.fixed_state([1.0, 0.0, 1.5])),
        time=js.Time(15, js.FreeTime(0.1, 10.0)),
    )
    np.testing.assert_allclose(solved(problem, final_time=3.0).final_time, 2.0, rtol=EXACT)


@pytest.mark.slow
def test_static_decision_variable():
    """Least (u - k)^2 + k^2 for a step of one metre in one second: u is linear, and k = 6/7."""
    problem = js.OptimalControlProblem(
        dynamics=js.with_static(js.DoubleIntegrator(1)),
        cost=js.Cost(lambda x, u, t, p: (u[0] - x[2]) ** 2, lambda x, t, p: x[2] ** 2),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0, None]), js.fixed_state([1.0, None, None])),
        time=js.Time(8, js.FixedTime(1.0)),
    )
    np.testing.assert_allclose(solved(problem).trajectory.state[:, 2], 6.0 / 7.0, rtol=EXACT)


@pytest.mark.nightly
def test_least_thrust():
    """The integral of |u|: full, none, full. With t1 seconds of thrust, 2 t1 (2 - t1) = 1."""
    problem = js.OptimalControlProblem(
        dynamics=js.Dynamics.of(lambda x, u, t, p: jnp.stack([x[1], u[0]]), 2, 2),
        cost=js.Cost(running=lambda x, u, t, p: u[1]),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state([1.0, 0.0])),
        time=js.Time(31, js.FreeTime(1.9, 2.0, dilation=(0.05, 10.0))),
        constraints=(
            js.bounds(control=([-2.0, None], [2.0, 2.5])),
            js.Constraint(
                lambda x, u, t, p: jnp.stack([u[1], u[0]]),
                js.SecondOrder(),
                where=js.AtNodes(),
                convex=True,
                name="size",
            ),
        ),
    )
    solution = solved(problem, final_time=1.9)
    np.testing.assert_allclose(solution.cost, 2.0 * 2.0 * (1.0 - np.sqrt(0.5)), rtol=1e-4)


@pytest.mark.nightly
def test_moving_target():
    """A target at 1 m that moves at 0.5 m/s: the least energy of its cubic, 12 d^2/T^3 - 12 d v/T^2 + 4 v^2/T."""

    def meets(x, t, p):
        return x - jnp.stack([1.0 + p * t, p])

    rows = js.EndRows("gap", "m"), js.EndRows("speed", "m/s")
    problem = js.OptimalControlProblem(
        dynamics=js.DoubleIntegrator(1),
        cost=ENERGY,
        boundary=js.Boundary(js.fixed_state([0.0, 0.0]), js.EndCondition(meets, 0.5, rows)),
        time=js.Time(15, js.FixedTime(2.0)),
    )
    guess = js.Trajectory.from_arrays([0.0, 2.0], [[0.0, 0.0], [2.0, 0.5]], [[0.0], [0.0]])
    solution = solved(problem, guess)
    d, v, T = 2.0, 0.5, 2.0
    np.testing.assert_allclose(solution.cost, 12 * d**2 / T**3 - 12 * d * v / T**2 + 4 * v**2 / T, rtol=EXACT)
    assert solution.certificate.end_names[-2:] == ("final gap", "final speed")
    assert solution.certificate.end_units[-2:] == ("m", "m/s")


@pytest.mark.nightly
def test_reference_that_changes_from_node_to_node():
    """A sine at 40 nodes, linear between: its chords err by h^2/8."""
    times = np.linspace(0.0, 3.0, 40)
    problem = js.OptimalControlProblem(
        dynamics=js.Dynamics.of(single_integrator, 1, 1),
        cost=js.Cost(
            running=lambda x, u, t, p: (x[0] - p["sine"]) ** 2 + 0.3 * u @ u,
            parameters={"sine": np.sin(times)},
            per_node=True,
        ),
        boundary=js.Boundary(js.fixed_state([0.0]), js.fixed_state([None])),
        time=js.Time(40, js.FixedTime(3.0)),
    )
    np.testing.assert_allclose(solved(problem).cost, sine_cost(0.3), rtol=2e-3)


@pytest.mark.nightly
def test_a_terminal_cost_that_is_not_affine_in_time():
    """t + 9 / t is least at 3 s."""
    problem = js.OptimalControlProblem(
        dynamics=js.Dynamics.of(single_integrator, 1, 1),
        cost=js.Cost(lambda x, u, t, p: (u[0] - 0.1) ** 2, lambda x, t, p: t + 9.0 / t),
        boundary=js.Boundary(js.fixed_state([0.0]), js.fixed_state([None])),
        time=js.Time(6, js.FreeTime(1.0, 10.0)),
    )
    np.testing.assert_allclose(solved(problem, final_time=2.0).final_time, 3.0, rtol=1e-3)


@pytest.mark.slow
def test_checks_are_for_the_certificate_alone():
    """A check that the optimum breaks does not move it, and is not passed over."""
    check = js.Constraint(slower, js.NonNegative(), 0.5, name="speed")
    problem = double_integrator(ENERGY, js.Time(6, js.FixedTime(2.0)), checks=(check,))
    solution = js.solve(problem, js.straight_line(problem))
    assert js.status_names(solution.status) == "verification_failed"
    np.testing.assert_allclose(solution.cost, 1.5, rtol=EXACT)
    np.testing.assert_allclose(solution.certificate.between_nodes, [0.25], rtol=1e-3)


@pytest.mark.nightly
def test_a_scale_changes_no_answer():
    """The cost, in the user's units, and rows of the certificate."""
    plain = double_integrator(ENERGY, js.Time(11, js.FixedTime(2.0)))
    scaled = dataclasses.replace(plain, scale=js.Scale(state=[3.0, 0.2], control=[5.0], time=0.7))
    one, other = solved(plain), solved(scaled)
    np.testing.assert_allclose(other.cost, one.cost, rtol=EXACT)
    np.testing.assert_allclose(other.trajectory.state, one.trajectory.state, atol=1e-4)


@pytest.mark.slow
def test_a_guess_off_both_ends():
    """By a metre and a metre a second."""
    problem = double_integrator(ENERGY, js.Time(11, js.FixedTime(2.0)))
    guess = js.Trajectory.from_arrays([0.0, 1.0, 2.0], [[1.0, 1.0], [1.0, 0.0], [2.0, 0.0]], np.zeros((3, 1)))
    np.testing.assert_allclose(solved(problem, guess).cost, 1.5, rtol=EXACT)


@pytest.mark.slow
@pytest.mark.parametrize("duration", [1.0, 1.9, 2.1])
def test_a_solution_is_a_guess_for_another_fixed_time(duration):
    """Of least energy, 12 d^2 / T^3; the plan for a longer time costs less than the optimum of a shorter one."""
    problem = lambda t: double_integrator(ENERGY, js.Time(6, js.FixedTime(t)))  # noqa: E731
    solution = js.solve(problem(2.0), js.straight_line(problem(2.0)))
    found = js.solve(problem(duration), solution)
    assert js.status_names(found.status) == "converged"
    np.testing.assert_allclose(found.cost, 12.0 / duration**3, rtol=1e-5)


@pytest.mark.slow
def test_a_solution_is_a_guess_for_another_number_of_nodes():
    coarse = solved(double_integrator(ENERGY, js.Time(6, js.FixedTime(2.0))))
    fine = double_integrator(ENERGY, js.Time(11, js.FixedTime(2.0)))
    np.testing.assert_allclose(solved(fine, coarse).cost, 1.5, rtol=EXACT)
