"""``NewtonSCP`` on problems that are no landings: optima known in closed form, or bounded by geometry."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxscp import NewtonSCP, Status
from jaxscp.backends.xla import options
from jaxscp.cones.cone import NonNegative
from jaxscp.dynamics.base import Dynamics
from jaxscp.dynamics.double_integrator import DoubleIntegrator
from jaxscp.landing.constraints import Limits, within_control_limits
from jaxscp.problem.constraint import AtNodes, Constraint, repeat_over_nodes
from jaxscp.problem.problem import (
    Boundary,
    FixedComponents,
    OptimalControlProblem,
    fixed_components,
    node_times,
)
from jaxscp.scp.method import iterate
from jaxscp.transcription.inequalities import inequalities
from jaxscp.transcription.shooting import evaluate
from jaxscp.transcription.stationarity import stationarity
from jaxscp.verification.gradient import verified_gradient

METHOD = NewtonSCP()
NODES = 21  # an even number of intervals, so that the switch of a bang-bang control can fall on a node
CAR_NODES = 30

# Relative. First-order hold cannot jump from +a to -a: with the mesh free, it does so over the shortest interval that
# the dilation's lower bound allows.
SWITCH = 2e-4
BARRIER = 1e-6  # relative: every limit, those of the dilation too, is relaxed by 1e-6 and then kept 1e-6 away
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
    """(parameters, guess) -> (cost, result), with the gradient in the parameters if asked for."""

    def cost(parameters, guess):
        problem = problem_of(parameters)
        result = iterate(METHOD, problem, problem.join(*guess))
        return result.cost, result

    function = jax.value_and_grad(cost, has_aux=True) if differentiable else cost
    return jax.jit(function, compiler_options=options())


def assert_optimal(result):
    assert bool(result.status == Status.converged)
    assert bool(result.is_optimum)


def fixed(value, components):
    return Boundary(fixed_components, FixedComponents(jnp.asarray(value), jnp.asarray(components)))


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


def effort(state, control, weights):
    return weights.energy * (control @ control)


def duration(state, time, weights):
    return weights.time * time


def without_limit(motion: Motion) -> OptimalControlProblem:
    final = jnp.stack([motion.distance, jnp.zeros_like(motion.distance)])
    return OptimalControlProblem(
        dynamics=DoubleIntegrator(1),
        running_cost=effort,
        terminal_cost=duration,
        weights=motion,
        constraints=(),
        initial=fixed(jnp.zeros(2), jnp.ones(2)),
        final=fixed(final, jnp.ones(2)),
        dilation_min=motion.shortest,
        dilation_max=motion.longest,
        nodes=NODES,
    )


def with_limit(motion: Motion) -> OptimalControlProblem:
    limits = repeat_over_nodes(Limits(-motion.limit[None], motion.limit[None]), NODES)
    on = jnp.ones(NODES, bool)
    # Not at the nodes alone: under a constant control all meshes are equally good, and the optimum is not unique.
    limit = Constraint(within_control_limits, limits, NonNegative(), on, "acceleration")
    return eqx.tree_at(lambda p: p.constraints, without_limit(motion), (limit,))


def smooth(distance: float, time: float):
    """States, controls and dilation from rest to rest, as a cubic in time."""
    part = jnp.linspace(0.0, 1.0, NODES)[:, None]
    position, velocity = part**2 * (3.0 - 2.0 * part), 6.0 * part * (1.0 - part) / time
    states = distance * jnp.concatenate([position, velocity], axis=1)
    return states, jnp.zeros((NODES, 1)), jnp.full(NODES, time)


def floats(parameters):
    return jax.tree.map(lambda v: jnp.array(v, float), parameters)


@pytest.fixture(scope="module")
def fastest():
    return compiled(with_limit, differentiable=False)


@pytest.mark.parametrize("distance", [1.0, 4.0])
def test_minimum_time(fastest, distance):
    """Full acceleration to the middle, full braking from there: t_f = 2 sqrt(d / a)."""
    motion = FASTEST._replace(distance=distance)
    cost, result = fastest(floats(motion), smooth(distance, 8.0))
    assert_optimal(result)
    best = 2.0 * np.sqrt(distance / motion.limit)
    assert best * (1.0 - BARRIER) <= float(cost) <= best * (1.0 + SWITCH)
    np.testing.assert_allclose(cost, node_times(result.z[:, -1])[-1], rtol=1e-12)


@pytest.fixture(scope="module")
def cheapest():
    """Without any path constraint."""
    return compiled(without_limit)


@pytest.mark.slow
def test_minimum_energy_at_a_fixed_time_without_constraints(cheapest):
    """The integral of u^2 is 12 d^2 / t_f^3, and u falls along a straight line. Two equal limits of the dilation fix
    t_f, so that the derivative in t_f is the sum of theirs."""
    d, T = CHEAPEST.distance, CHEAPEST.longest
    (cost, result), gradient = cheapest(floats(CHEAPEST), smooth(d, T))
    assert_optimal(result)
    np.testing.assert_allclose(cost, 12.0 * d**2 / T**3, rtol=BARRIER)
    time = node_times(result.z[:, -1])
    np.testing.assert_allclose(result.z[:, 2], 6.0 * d / T**2 * (1.0 - 2.0 * time / T), atol=STRAIGHT)
    np.testing.assert_allclose(gradient.distance, 24.0 * d / T**3, rtol=BARRIER)
    np.testing.assert_allclose(gradient.shortest + gradient.longest, -36.0 * d**2 / T**4, rtol=BARRIER)


@pytest.mark.slow
def test_time_against_energy_without_constraints(cheapest):
    """t_f + w times the integral of u^2 is least at t_f^4 = 36 w d^2, and is 4/3 t_f there."""
    (cost, result), gradient = cheapest(floats(BOTH), smooth(BOTH.distance, 4.0))
    assert_optimal(result)
    best = (36.0 * BOTH.energy * BOTH.distance**2) ** 0.25
    np.testing.assert_allclose(node_times(result.z[:, -1])[-1], best, rtol=FLAT)
    np.testing.assert_allclose(cost, 4.0 / 3.0 * best, rtol=BARRIER)
    np.testing.assert_allclose(gradient.distance, 2.0 / 3.0 * best / BOTH.distance, rtol=BARRIER)
    np.testing.assert_allclose(gradient.energy, best / 3.0 / BOTH.energy, rtol=BARRIER)


# --- Dubins car around a disc ---


class Car(Dynamics):
    """State (x, y, heading) at unit speed; control: turn rate in rad/s."""

    @property
    def state_size(self) -> int:
        return 3

    @property
    def control_size(self) -> int:
        return 1

    def __call__(self, state, control):
        return jnp.stack([jnp.cos(state[2]), jnp.sin(state[2]), control[0]])


EFFORT = 0.01  # cost of u^2, against one of a second
GOAL = 6.0  # m, on the x axis
DISC = jnp.array([3.0, 0.2, 1.0])  # centre and radius in m; it blocks the straight path


def time_and_effort(state, control, weights):
    return 1.0 + EFFORT * (control @ control)


def no_terminal_cost(state, time, weights):
    return jnp.zeros(())


def outside_disc(state, control, time, disc):
    return jnp.linalg.norm(state[:2] - disc[:2])[None] - disc[2]


def around(disc) -> OptimalControlProblem:
    on = jnp.ones(CAR_NODES, bool)
    limits = repeat_over_nodes(Limits(-jnp.ones(1), jnp.ones(1)), CAR_NODES)
    discs = repeat_over_nodes(disc, CAR_NODES)
    return OptimalControlProblem(
        dynamics=Car(),
        running_cost=time_and_effort,
        terminal_cost=no_terminal_cost,
        weights=(),
        constraints=(
            Constraint(within_control_limits, limits, NonNegative(), on, "turn rate", AtNodes()),
            Constraint(outside_disc, discs, NonNegative(), on, "disc", convex=False),
        ),
        initial=fixed(jnp.zeros(3), jnp.ones(3)),
        final=fixed([GOAL, 0.0, 0.0], [1.0, 1.0, 0.0]),  # any heading
        dilation_min=jnp.array(1.0),
        dilation_max=jnp.array(20.0),
        nodes=CAR_NODES,
    )


def bow(height: float):
    """States, controls and dilation of a guess from end to end, half a sine to one side; it need not be a motion."""
    part = jnp.linspace(0.0, 1.0, CAR_NODES)[:, None]
    states = jnp.concatenate([GOAL * part, height * jnp.sin(jnp.pi * part), 0.0 * part], axis=1)
    return states, jnp.zeros((CAR_NODES, 1)), jnp.full(CAR_NODES, GOAL)


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


SIDES = pytest.mark.parametrize("side", [-1.0, 1.0], ids=["below", "above"])


@pytest.mark.slow
@SIDES
def test_car_takes_the_shortest_path(drive, side):
    """No path is shorter than the Dubins path, whose cost bounds the optimum from above."""
    (cost, result), _ = drive(DISC, bow(side))
    assert_optimal(result)
    length, turn = dubins_path(side)
    time = float(node_times(result.z[:, -1])[-1])
    assert length * (1.0 - BARRIER) <= time <= float(cost)
    assert float(cost) <= (length + EFFORT * turn) * (1.0 + JUMPS)


def driven(z, samples: int = 50):
    """States (intervals, samples, 3) of the planned controls, integrated from the start to the end by SciPy."""
    turn, dilation = np.asarray(z[:, 3]), np.asarray(z[:, 4])
    states, state = [], np.asarray(z[0, :3])
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
    (_, result), _ = drive(DISC, bow(side))
    path = driven(result.z)
    np.testing.assert_allclose(path[0, 0], 0.0, atol=INTEGRATION)
    np.testing.assert_allclose(path[-1, -1, :2], [GOAL, 0.0], atol=INTEGRATION)
    clearance = np.linalg.norm(path[..., :2] - DISC[:2], axis=-1) - DISC[2]
    assert clearance.min() >= -INTEGRATION
    assert np.max(np.abs(result.z[:, 3])) <= 1.0 + INTEGRATION


@pytest.fixture(scope="module")
def conditions():
    """(disc, end) -> residual of stationarity by an independent integration, and values of the inequalities."""

    def of(disc, end):
        problem = around(disc)
        values = inequalities(problem, end.z, evaluate(problem, end.z, METHOD.grid))
        gradient = verified_gradient(problem, end.z, end.multipliers, METHOD.grid)
        return stationarity(gradient, end.z, end.cost), values

    return jax.jit(of, compiler_options=options())


@pytest.mark.slow
@SIDES
def test_car_ends_where_the_conditions_of_optimality_hold(drive, conditions, side):
    """Stationarity, signs of values and multipliers, complementarity."""
    (_, end), _ = drive(DISC, bow(side))
    stationary, values = conditions(DISC, end)
    assert float(stationary) <= STATIONARY
    for multipliers, value in zip(end.multipliers.values, values, strict=True):
        assert float(jnp.min(multipliers)) >= 0.0
        assert float(jnp.min(value)) >= -INTEGRATION
        assert float(jnp.max(multipliers * jnp.abs(value))) <= COMPLEMENTARY


@pytest.mark.slow
def test_gradient_in_the_disc_agrees_with_finite_differences(drive):
    _, gradient = drive(DISC, bow(-1.0))
    differences = [
        (drive(DISC + step, bow(-1.0))[0][0] - drive(DISC - step, bow(-1.0))[0][0]) / (2.0 * STEP)
        for step in STEP * jnp.eye(3)
    ]
    np.testing.assert_allclose(gradient, differences, rtol=DIFFERENCE, atol=DIFFERENCE)
