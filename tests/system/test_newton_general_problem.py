"""``NewtonSCP`` on problems that are no landings: optima known in closed form, or bounded by geometry."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxscp
from jaxscp import NewtonSCP, Trajectory
from jaxscp.backends.xla import compiler_options
from jaxscp.problem.canonical import canonical
from jaxscp.problem.form import Continuous
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.problem.node_values import node_times
from jaxscp.transcription.inequalities import inequalities
from jaxscp.transcription.shooting import evaluate
from tests.support.own_problems import EFFORT, dubins

METHOD = NewtonSCP()
NODES = 21  # an even number of intervals, so that the switch of a bang-bang control can fall on a node
CAR_NODES = 30

# Relative. First-order hold cannot jump from +a to -a: with the mesh free, it does so over the shortest interval that
# the dilation's lower bound allows.
SWITCH = 2e-4
BARRIER = 1e-6  # relative: every limit, also of the dilation, is relaxed by 1e-6 and then kept 1e-6 away
STRAIGHT = 1e-5  # m/s^2: ten times that, since the energy hardly depends on it
FLAT = 1e-3  # relative: a final time that misses the best one by so much costs only the square of that
# Relative. The Dubins path turns in jumps, which first-order hold cannot, and a margin is kept between the nodes.
JUMPS = 1e-3
INTEGRATION = 1e-6  # m: error of the planner's sixth-order integration over a whole path
STATIONARY = 1e-6  # relative; the interior point ends at 1e-8, and the test integrates by another method
COMPLEMENTARY = 1e-5  # products of multipliers and values: ten times the mu of the optimum, 1e-6
STEP = 1e-3  # m, of finite differences
DIFFERENCE = 1e-4  # relative: STEP squared times third derivatives, and optima that agree to 1e-9


def compiled(problem_of, differentiable=True):
    """(parameters, guess) -> (cost, solution), with the gradient in the parameters if asked for."""

    def cost(parameters, guess):
        solution = jaxscp.solve(problem_of(parameters), guess)
        return solution.cost, solution

    function = jax.value_and_grad(cost, has_aux=True) if differentiable else cost
    return jax.jit(function, compiler_options=compiler_options())


def assert_optimal(solution):
    assert jaxscp.status_names(solution.status) == "converged"
    assert bool(solution.differentiable)


def guessed(states, duration):
    """A trajectory on an even mesh, without controls."""
    nodes = states.shape[0]
    dilation = jnp.full(nodes, duration)
    return Trajectory(node_times(dilation), states, jnp.zeros((nodes, 1)), dilation)


# --- double integrator, from rest to rest ---


class Motion(NamedTuple):
    """Parameters of the problem, and weights of its cost."""

    distance: float
    limit: float
    shortest: float
    longest: float
    energy: float
    time: float


FASTEST = Motion(distance=1.0, limit=2.0, shortest=0.05, longest=10.0, energy=0.0, time=1.0)
CHEAPEST = Motion(distance=1.0, limit=jnp.inf, shortest=2.0, longest=2.0, energy=1.0, time=0.0)
BOTH = Motion(distance=1.0, limit=jnp.inf, shortest=0.05, longest=10.0, energy=0.5, time=1.0)


def effort(state, control, time, motion):
    return motion.energy * (control @ control)


def duration(state, time, motion):
    return motion.time * time


def without_limit(motion: Motion) -> jaxscp.OptimalControlProblem:
    return jaxscp.OptimalControlProblem(
        dynamics=jaxscp.DoubleIntegrator(1),
        cost=jaxscp.Cost(effort, duration, motion),
        boundary=jaxscp.Boundary(jaxscp.fixed_state([0.0, 0.0]), jaxscp.fixed_state([motion.distance, 0.0])),
        time=jaxscp.Time(NODES, jaxscp.FreeTime(motion.shortest, motion.longest)),
    )


def with_limit(motion: Motion) -> jaxscp.OptimalControlProblem:
    limits = jaxscp.bounds(control=(-motion.limit, motion.limit), name="acceleration")
    return eqx.tree_at(lambda p: p.constraints, without_limit(motion), (limits,))


def smooth(distance: float, time: float) -> Trajectory:
    """From rest to rest, as a cubic in time."""
    part = jnp.linspace(0.0, 1.0, NODES)[:, None]
    position, velocity = part**2 * (3.0 - 2.0 * part), 6.0 * part * (1.0 - part) / time
    return guessed(distance * jnp.concatenate([position, velocity], axis=1), time)


def floats(parameters):
    return jax.tree.map(lambda v: jnp.array(v, float), parameters)


@pytest.fixture(scope="module")
def fastest():
    return compiled(with_limit, differentiable=False)


@pytest.mark.slow
@pytest.mark.parametrize("distance", [1.0, 4.0])
def test_minimum_time(fastest, distance):
    """Full acceleration to the middle, full braking from there: t_f = 2 sqrt(d / a)."""
    motion = FASTEST._replace(distance=distance)
    cost, solution = fastest(floats(motion), smooth(distance, 8.0))
    assert_optimal(solution)
    best = 2.0 * np.sqrt(distance / motion.limit)
    assert best * (1.0 - BARRIER) <= float(cost) <= best * (1.0 + SWITCH)
    np.testing.assert_allclose(cost, solution.final_time, rtol=1e-12)


@pytest.fixture(scope="module")
def cheapest():
    """Without any path constraint."""
    return compiled(without_limit)


@pytest.mark.nightly
def test_minimum_energy_at_a_fixed_time_without_constraints(cheapest):
    """The integral of u^2 is 12 d^2 / t_f^3, and u falls along a straight line. Two equal limits of the dilation fix
    t_f, so that the derivative in t_f is the sum of theirs."""
    d, T = CHEAPEST.distance, CHEAPEST.longest
    (cost, solution), gradient = cheapest(floats(CHEAPEST), smooth(d, T))
    assert_optimal(solution)
    np.testing.assert_allclose(cost, 12.0 * d**2 / T**3, rtol=BARRIER)
    time, control = solution.trajectory.time, solution.trajectory.control[:, 0]
    np.testing.assert_allclose(control, 6.0 * d / T**2 * (1.0 - 2.0 * time / T), atol=STRAIGHT)
    np.testing.assert_allclose(gradient.distance, 24.0 * d / T**3, rtol=BARRIER)
    np.testing.assert_allclose(gradient.shortest + gradient.longest, -36.0 * d**2 / T**4, rtol=BARRIER)


@pytest.mark.slow
@pytest.mark.slow
def test_time_against_energy_without_constraints(cheapest):
    """t_f + w times the integral of u^2 is least at t_f^4 = 36 w d^2, and is 4/3 t_f there."""
    (cost, solution), gradient = cheapest(floats(BOTH), smooth(BOTH.distance, 4.0))
    assert_optimal(solution)
    best = (36.0 * BOTH.energy * BOTH.distance**2) ** 0.25
    np.testing.assert_allclose(solution.final_time, best, rtol=FLAT)
    np.testing.assert_allclose(cost, 4.0 / 3.0 * best, rtol=BARRIER)
    np.testing.assert_allclose(gradient.distance, 2.0 / 3.0 * best / BOTH.distance, rtol=BARRIER)
    np.testing.assert_allclose(gradient.energy, best / 3.0 / BOTH.energy, rtol=BARRIER)


# --- Dubins car around a disc ---

GOAL = 6.0  # m, on the x axis
DISC = jnp.array([3.0, 0.2, 1.0])  # centre and radius in m; it blocks the straight path


def around(disc) -> jaxscp.OptimalControlProblem:
    """On a free mesh: a weight of the mesh would make more local optima, too close for finite differences."""
    time = jaxscp.Time(CAR_NODES, jaxscp.FreeTime(1.0, 20.0), mesh_weight=None)
    parameters = {"centre": disc[:2], "radius": disc[2]}
    parts = lambda p: (p.time, p.constraints[1].parameters)  # noqa: E731
    return eqx.tree_at(parts, dubins(disc[1]), (time, parameters))


def bow(height: float) -> Trajectory:
    """A guess from end to end, half a sine to one side; it need not be a motion."""
    part = jnp.linspace(0.0, 1.0, CAR_NODES)[:, None]
    states = jnp.concatenate([GOAL * part, height * jnp.sin(jnp.pi * part), 0.0 * part], axis=1)
    return guessed(states, GOAL)


def dubins_path(side: float) -> tuple[float, float]:
    """Length of the shortest path of turn rates up to one, and the angle that it turns by in all.

    An arc of radius one, a tangent that touches the disc from the other side, an arc of the disc, a tangent to the
    goal. As the disc's radius is one, the car can follow it.

    Args:
        side: 1 where the path passes above the disc, -1 below.
    """
    x, y, radius = np.array(DISC) * [1.0, side, 1.0]  # mirrored, so that it passes above
    to_disc, to_goal = np.array([x, y - 1.0]), np.array([GOAL - x, -y])
    between, after = np.linalg.norm(to_disc), np.linalg.norm(to_goal)
    first = np.arctan2(to_disc[1], to_disc[0]) + np.arcsin((1.0 + radius) / between)
    second = np.arctan2(to_goal[1], to_goal[0]) - np.arcsin(radius / after)
    straight = np.sqrt(between**2 - (1.0 + radius) ** 2) + np.sqrt(after**2 - radius**2)
    return straight + first + radius * (first - second), first + (first - second)


@pytest.fixture(scope="module")
def drive():
    return compiled(around)


SIDES = pytest.mark.parametrize(
    "side", [pytest.param(-1.0, id="below", marks=pytest.mark.nightly), pytest.param(1.0, id="above")]
)


@pytest.mark.nightly
@SIDES
def test_car_takes_the_shortest_path(drive, side):
    """No path is shorter than the Dubins path, whose cost bounds the optimum from above."""
    (cost, solution), _ = drive(DISC, bow(side))
    assert_optimal(solution)
    length, turn = dubins_path(side)
    time = float(solution.final_time)
    assert length * (1.0 - BARRIER) <= time <= float(cost)
    assert float(cost) <= (length + EFFORT * turn) * (1.0 + JUMPS)


def driven(plan: Trajectory, samples: int = 50):
    """States (intervals, samples, 3) of the planned controls, integrated from the start to the end by SciPy."""
    turn, dilation = np.asarray(plan.control[:, 0]), np.asarray(plan.dilation)
    states, state = [], np.asarray(plan.state[0])
    for k in range(CAR_NODES - 1):

        def slope(part, v, k=k):
            at = lambda w: (1.0 - part) * w[k] + part * w[k + 1]  # noqa: E731
            return at(dilation) / (CAR_NODES - 1) * np.array([np.cos(v[2]), np.sin(v[2]), at(turn)])

        parts = np.linspace(0.0, 1.0, samples)
        found = solve_ivp(slope, (0.0, 1.0), state, method="DOP853", t_eval=parts, rtol=1e-11, atol=1e-12)
        states.append(found.y.T)
        state = found.y[:, -1]
    return np.stack(states)


@pytest.mark.slow
@SIDES
def test_car_reaches_the_goal_outside_the_disc(drive, side):
    (_, solution), _ = drive(DISC, bow(side))
    path = driven(solution.trajectory)
    np.testing.assert_allclose(path[0, 0], 0.0, atol=INTEGRATION)
    np.testing.assert_allclose(path[-1, -1, :2], [GOAL, 0.0], atol=INTEGRATION)
    clearance = np.linalg.norm(path[..., :2] - DISC[:2], axis=-1) - DISC[2]
    assert clearance.min() >= -INTEGRATION
    assert np.max(np.abs(solution.trajectory.control)) <= 1.0 + INTEGRATION


@pytest.fixture(scope="module")
def values():
    """(disc, guess, node variables) -> values of the inequalities."""

    def of(disc, guess, z):
        problem = over_scaled_time(canonical(around(disc)), Continuous(), guess)
        return inequalities(problem, z, evaluate(problem, z, METHOD.grid))

    return jax.jit(of, compiler_options=compiler_options())


@pytest.mark.slow
@SIDES
def test_car_ends_where_the_conditions_of_optimality_hold(drive, values, side):
    """Stationarity by the certificate's own integration, signs of values and multipliers, complementarity."""
    (_, solution), _ = drive(DISC, bow(side))
    assert float(solution.certificate.optimality) <= STATIONARY
    multipliers = solution.multipliers.values
    for multiplier, value in zip(multipliers, values(DISC, bow(side), solution.z), strict=True):
        assert float(jnp.min(multiplier)) >= 0.0
        assert float(jnp.min(value)) >= -INTEGRATION
        assert float(jnp.max(multiplier * jnp.abs(value))) <= COMPLEMENTARY


@pytest.mark.slow
def test_gradient_in_the_disc_agrees_with_finite_differences(drive):
    _, gradient = drive(DISC, bow(-1.0))
    differences = [
        (drive(DISC + step, bow(-1.0))[0][0] - drive(DISC - step, bow(-1.0))[0][0]) / (2.0 * STEP)
        for step in STEP * jnp.eye(3)
    ]
    np.testing.assert_allclose(gradient, differences, rtol=DIFFERENCE, atol=DIFFERENCE)
