"""An independent judge: SciPy's DOP853 integrates a plan's controls, and the true boxes are asked."""

import numpy as np

import jaxscp
from benchmarks.fuzz.oracle import rollout
from benchmarks.robustness.chains import clearance

MILLIMETRE, SPEED, ANGLE = 1e-3, 1e-2, 2e-3  # errors at the end that count as none: m, m/s, rad
OUTSIDE = 2e-3  # m beyond the corridor that count as none
THRUST = 1e-3  # of the limits' range
ACCURACY = 1e-10  # of the integration


def refuted(scenario: jaxscp.LandingScenario, solution: jaxscp.Solution) -> str:
    """Names of the conditions that a plan breaks; empty if it keeps all."""
    path, control = rollout(scenario, solution, ACCURACY), np.asarray(solution.trajectory.control)
    state = path[-1]
    goal = np.asarray(scenario.goal.vector())
    low, high = np.asarray(scenario.airframe.thrust_min), np.asarray(scenario.airframe.thrust_max)
    slack = THRUST * (high - low)
    overlap = abs(np.dot(state[6:10], goal[6:10])) / np.linalg.norm(state[6:10])
    faults = {
        "goal missed": np.linalg.norm(state[:3] - goal[:3]) > MILLIMETRE,
        "speed at the goal": np.linalg.norm(state[3:6] - goal[3:6]) > SPEED,
        "attitude at the goal": 2.0 * np.arccos(min(overlap, 1.0)) > ANGLE,
        "outside the corridor": clearance(scenario, path[:, :3]) < -OUTSIDE,
        "thrust": bool(np.any(control < low - slack) or np.any(control > high + slack)),
    }
    return ", ".join(name for name, wrong in faults.items() if wrong)
