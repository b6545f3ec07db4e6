"""Plans of Case 1 with a reserve of thrust, and flights along them: for tests and for ``benchmarks.control``."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxscp
from jaxscp.control import NMPC, Actuators, Horizon, Reference, bounded_qp, subproblem
from jaxscp.control.prediction import linearise, sensitivities
from tests.support import closed_loop
from tests.support.closed_loop import NOISE, Plant, Record, wind

AIRFRAME = jaxscp.airframes.paper_mav()
MOTORS = Actuators(AIRFRAME.thrust_min, AIRFRAME.thrust_max, rate=80.0, time_constant=0.03, delay=2)
"""Lag 30 ms, delay 20 ms."""
HOVER = jnp.full(4, float(AIRFRAME.body.mass) * 9.81 / 4)
RESERVE = 0.5, 4.3
"""N: limits of the plan. The motors give 0.3 to 5 N: the rest is for tracking."""
UNIFORM_TIME = 3.6
"""s: dt/dtau of the plan on a uniform mesh, within one per cent. It is longer than the adaptive plan's time."""
AFTER = 100  # ticks of hover after a plan
CALM = Plant(AIRFRAME.body, MOTORS, NOISE, wind, jnp.zeros(3))


def heavy(fraction):
    """The body with another mass, as a fraction of its own."""
    return eqx.tree_at(lambda body: body.mass, AIRFRAME.body, AIRFRAME.body.mass * fraction)


ROUGH = Plant(heavy(1.1), MOTORS, NOISE, wind, jnp.array([1.0, 0.5, 0.0]))
"""A tenth heavier than the model, in a wind that pushes with 1.1 N and gusts."""


def controller(iterations=7) -> NMPC:
    """The controller of all flights."""
    return NMPC(AIRFRAME.body, MOTORS, horizon=Horizon(iterations=iterations))


def scenario():
    """Case 1 with a reserve of thrust."""
    limits = tuple(jnp.full(4, limit) for limit in RESERVE)
    return eqx.tree_at(
        lambda s: (s.airframe.thrust_min, s.airframe.thrust_max),
        jaxscp.scenarios.platform_to_platform(),
        limits,
    )


@functools.cache
def adaptive_plan():
    """The plan whose mesh adapts in time."""
    return jaxscp.Planner(nodes=30)(scenario())


@functools.cache
def uniform_plan():
    """The plan whose nodes are at equal distances in time."""
    limits = jnp.asarray(0.99 * UNIFORM_TIME), jnp.asarray(1.01 * UNIFORM_TIME)
    return jaxscp.Planner(nodes=30)(
        eqx.tree_at(lambda s: (s.dilation_min, s.dilation_max), scenario(), limits)
    )


@eqx.filter_jit
def flight(nmpc: NMPC, reference: Reference, plant: Plant, start, key=None, ticks=400) -> Record:
    """A flight from a state."""
    loop = closed_loop.begin(nmpc, reference, plant, start)
    return closed_loop.fly(nmpc, reference, plant, loop, ticks, key)


def flight_along(nmpc: NMPC, reference: Reference, plant: Plant, key=None) -> Record:
    """A flight along a plan, and a second of hover at its end."""
    end = float(reference.step) * (reference.state.shape[0] - 2)
    return flight(nmpc, reference, plant, reference.state[0], key, ticks=int(100 * end) + AFTER)


def tracking_error(record: Record, reference: Reference):
    """Root-mean-square distance in m from the plan, while it lasts."""
    end = reference.step * (reference.state.shape[0] - 2)
    during = record.time <= end
    distance = np.linalg.norm(record.state[:, :3] - reference.at(record.time)[0][:, :3], axis=1)
    return np.sqrt(np.mean(distance[during] ** 2))


@eqx.filter_jit
def program_of(nmpc: NMPC, reference: Reference, state):
    """The convex program of a first tick from a state, and its solution by the controller's interior point."""
    grid, plan = nmpc.horizon.grid, nmpc.init(reference, state).plan
    plan = eqx.tree_at(lambda p: p.state, plan, plan.state.at[0].set(state))
    linear = linearise(nmpc.dynamics, jnp.zeros(13), plan, grid, nmpc.horizon.steps)
    target = reference.compensated(plan.time + grid, jnp.zeros(6))
    qp = subproblem.tracking_qp(nmpc.tracking, nmpc.actuators, plan, target, sensitivities(linear), grid)
    centre = subproblem.centre(nmpc.actuators, plan.control[0], grid)
    return qp, bounded_qp.solve(qp, plan.control[1:], centre, nmpc.horizon.iterations).v
