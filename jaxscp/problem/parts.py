"""Checks of a problem's parts: each is of the class that its field needs."""

import operator
from typing import Any

from jaxscp.cones.cone import Cone
from jaxscp.core.errors import InvalidProblem
from jaxscp.dynamics.base import Dynamics
from jaxscp.problem.boundary import Boundary, EndCondition
from jaxscp.problem.constraint import Constraint, Where
from jaxscp.problem.cost import Cost
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.time import FixedTime, FreeTime, Time


def check_parts(problem: OptimalControlProblem) -> None:
    """Raise for a part of another class: a class in place of its instance, say."""
    parts: list[tuple[str, Any, type | tuple[type, ...]]] = [
        ("dynamics", problem.dynamics, Dynamics),
        ("cost", problem.cost, Cost),
        ("boundary", problem.boundary, Boundary),
        ("boundary.initial", problem.boundary.initial, EndCondition),
        ("boundary.final", problem.boundary.final, EndCondition),
        ("time", problem.time, Time),
        ("time.final", problem.time.final, (FreeTime, FixedTime)),
    ]
    for field, part, expected in parts:
        check_instance(field, part, expected)
    _check_count("dynamics.states", problem.dynamics.state_size, 1)
    _check_count("dynamics.controls", problem.dynamics.control_size, 0)
    _check_count("time.nodes", problem.time.nodes, 2)
    for field in ("constraints", "checks", "zero_order_hold"):
        value = getattr(problem, field)
        if not isinstance(value, tuple | list):
            raise InvalidProblem(
                f"{field}: expected a tuple, got a {type(value).__name__}. A tuple of one needs a comma: (one,)."
            )
    for field, c in problem.named_constraints():
        check_instance(field, c, Constraint)
        check_instance(f"{field}.cone", c.cone, Cone)
        check_instance(f"{field}.where", c.where, Where)


def check_instance(field: str, part: Any, expected: type | tuple[type, ...]) -> None:
    """Raise for a part of another class: a class in place of its instance, say."""
    if isinstance(part, type) or not isinstance(part, expected):
        names = expected.__name__ if isinstance(expected, type) else " or ".join(c.__name__ for c in expected)
        found = (
            f"the class {part.__name__}; call it" if isinstance(part, type) else f"a {type(part).__name__}"
        )
        raise InvalidProblem(f"{field}: expected an instance of {names}, got {found}.")


def _check_count(field: str, value: Any, least: int) -> None:
    try:
        good = operator.index(value) >= least
    except TypeError:
        good = False
    if not good:
        raise InvalidProblem(f"{field}: expected a whole number, {least} or more, got {value!r}.")
