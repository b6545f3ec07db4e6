"""An independent judge: SciPy's DOP853 integrates a plan's controls, and the true boxes are asked."""

import jax
import numpy as np
from scipy.integrate import solve_ivp

import jaxscp
from benchmarks.robustness.chains import clearance

MILLIMETRE, SPEED, ANGLE = 1e-3, 1e-2, 2e-3  # errors at the end that count as none: m, m/s, rad
OUTSIDE = 2e-3  # m beyond the corridor that count as none
THRUST = 1e-3  # of the limits' range
SAMPLES = 20  # of an interval
ACCURACY = 1e-10  # of the integration


@jax.jit
def _rate(scenario: jaxscp.LandingScenario, plan: jaxscp.Trajectory, time, state):
    return scenario.airframe.body(state, plan.control_at(time))


def refuted(scenario: jaxscp.LandingScenario, solution: jaxscp.Solution) -> str:
    """Names of the conditions that a plan breaks; empty if it keeps all."""
    plan = jax.tree.map(np.asarray, solution.trajectory)
    slope = lambda t, x: np.asarray(_rate(scenario, solution.trajectory, t, x))  # noqa: E731
    state, positions = np.asarray(scenario.start.vector()), []
    for first, last in zip(plan.time[:-1], plan.time[1:], strict=True):
        parts = np.linspace(first, last, SAMPLES)
        found = solve_ivp(
            slope, (first, last), state, method="DOP853", t_eval=parts, rtol=ACCURACY, atol=ACCURACY
        )
        state = found.y[:, -1]
        positions.append(found.y[:3].T)
    goal = np.asarray(scenario.goal.vector())
    low, high = np.asarray(scenario.airframe.thrust_min), np.asarray(scenario.airframe.thrust_max)
    slack = THRUST * (high - low)
    overlap = abs(np.dot(state[6:10], goal[6:10])) / np.linalg.norm(state[6:10])
    faults = {
        "goal missed": np.linalg.norm(state[:3] - goal[:3]) > MILLIMETRE,
        "speed at the goal": np.linalg.norm(state[3:6] - goal[3:6]) > SPEED,
        "attitude at the goal": 2.0 * np.arccos(min(overlap, 1.0)) > ANGLE,
        "outside the corridor": clearance(scenario, np.concatenate(positions)) < -OUTSIDE,
        "thrust": bool(np.any(plan.control < low - slack) or np.any(plan.control > high + slack)),
    }
    return ", ".join(name for name, wrong in faults.items() if wrong)
