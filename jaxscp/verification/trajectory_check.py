"""Whether a trajectory can be one of a problem: sizes, held controls, and final time."""

import numpy as np

from jaxscp.core.arrays import namespace
from jaxscp.core.errors import InvalidProblem
from jaxscp.problem.boundary import END_TOLERANCE
from jaxscp.problem.node_values import node_times
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.time import FixedTime
from jaxscp.problem.trajectory import Trajectory


def check_trajectory(problem: OptimalControlProblem, trajectory: Trajectory) -> None:
    """Refuse a trajectory of another problem; numbers that are traced are not compared.

    Raises:
        InvalidProblem: names the field.

    Example:
        >>> import jaxscp
        >>> scenario = jaxscp.scenarios.ascent_to_platform()
        >>> problem, _ = scenario.problem(10)
        >>> check_trajectory(problem, jaxscp.Trajectory.from_arrays([0.0, 1.0], np.zeros((2, 3)), np.zeros((2, 4))))
        Traceback (most recent call last):
        jaxscp.core.errors.InvalidProblem: trajectory.state: 3 components, but dynamics has 13.
    """
    _check_sizes(problem, trajectory)
    _check_time(problem, trajectory)


def _check_sizes(problem: OptimalControlProblem, trajectory: Trajectory) -> None:
    for name, size in (("state", problem.dynamics.state_size), ("control", problem.dynamics.control_size)):
        if getattr(trajectory, name).shape[-1] != size:
            raise InvalidProblem(
                f"trajectory.{name}: {getattr(trajectory, name).shape[-1]} components, but dynamics has {size}."
            )
    if trajectory.zero_order_hold != problem.zero_order_hold:
        raise InvalidProblem(
            f"trajectory.zero_order_hold: {trajectory.zero_order_hold}, but the problem's is {problem.zero_order_hold}."
        )


def _check_time(problem: OptimalControlProblem, trajectory: Trajectory) -> None:
    """Refuse known times outside the problem's limits, or which are not the integral of the dilation."""
    final = problem.time.final
    if namespace(final, trajectory.time, trajectory.dilation) is not np:
        return
    lower, upper = (final.duration,) * 2 if isinstance(final, FixedTime) else (final.lower, final.upper)
    last, integral = float(trajectory.time[-1]), float(node_times(trajectory.dilation)[-1])
    if last < lower * (1.0 - END_TOLERANCE) or last > upper * (1.0 + END_TOLERANCE):
        within = (
            f"{float(lower):g} s" if lower == upper else f"within {float(lower):g} and {float(upper):g} s"
        )
        raise InvalidProblem(
            f"trajectory.time: it lasts {last:g} s, but the problem's final time is {within}."
        )
    if abs(last - integral) > END_TOLERANCE * last:
        raise InvalidProblem(f"trajectory.time: it lasts {last:g} s, but its dilation lasts {integral:g} s.")
