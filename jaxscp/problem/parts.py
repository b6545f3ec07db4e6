"""Checks of a problem's parts: each is of the class that its field needs."""

from typing import Any

from jaxscp.cones.cone import Cone
from jaxscp.core.arrays import is_whole
from jaxscp.core.errors import InvalidProblem
from jaxscp.dynamics.base import Dynamics
from jaxscp.problem.boundary import Boundary, CoupledEnds, EndCondition
from jaxscp.problem.constraint import Constraint, Where
from jaxscp.problem.cost import Cost
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.scale import Scale
from jaxscp.problem.time import FixedTime, FreeTime, Time

_HINTS = {
    "dynamics": "Dynamics.of(function, states=..., controls=...) makes one",
    "cost": "Cost(running=...) or Cost(terminal=...) makes one from functions",
    "boundary": "Boundary(fixed_state([...]), fixed_state([...])) makes one",
    "boundary.initial": "fixed_state([...]) makes one",
    "boundary.final": "fixed_state([...]) makes one",
    "boundary.coupled": "periodic() makes one",
    "time": "Time(nodes=30, final=FixedTime(2.0)) makes one, or with FreeTime(lower, upper)",
    "time.final": "FixedTime(2.0), say, or FreeTime(lower, upper)",
    "scale": "Scale(state=[...], control=[...], time=...) makes one",
}


def check_parts(problem: OptimalControlProblem) -> None:
    """Raise for a part of another class: a class in place of its instance, say."""
    check_instance("problem", problem, OptimalControlProblem)
    check_instance("dynamics", problem.dynamics, Dynamics)
    check_instance("cost", problem.cost, Cost)
    check_instance("boundary", boundary := problem.boundary, Boundary)
    check_instance("boundary.initial", boundary.initial, EndCondition)
    check_instance("boundary.final", boundary.final, EndCondition)
    check_instance("boundary.coupled", boundary.coupled, (CoupledEnds, type(None)))
    check_instance("time", problem.time, Time)
    check_instance("time.final", problem.time.final, (FreeTime, FixedTime))
    check_instance("scale", problem.scale, (Scale, type(None)))
    _check_count("dynamics.states", problem.dynamics.state_size, 1)
    _check_count("dynamics.controls", problem.dynamics.control_size, 0)
    _check_count("time.nodes", problem.time.nodes, 2)
    for field in ("constraints", "checks", "zero_order_hold"):
        value = getattr(problem, field)
        if not isinstance(value, tuple | list):
            raise InvalidProblem(
                f"{field}: expected a tuple, got a {type(value).__name__}. A tuple of one needs a comma: (one,)."
            )
    for number in problem.zero_order_hold:
        _check_count("zero_order_hold", number, 0)
    for field, c in problem.named_constraints():
        check_instance(field, c, Constraint)
        check_instance(f"{field}.cone", c.cone, Cone)
        check_instance(f"{field}.where", c.where, Where)


def check_instance(field: str, part: Any, expected: type | tuple[type, ...]) -> None:
    """Raise for a part of another class: a class in place of its instance, say."""
    if isinstance(part, type) or not isinstance(part, expected):
        classes = (expected,) if isinstance(expected, type) else expected
        names = " or ".join("None" if c is type(None) else c.__name__ for c in classes)
        found = (
            f"the class {part.__name__}; call it" if isinstance(part, type) else f"a {type(part).__name__}"
        )
        hint = f" {_HINTS[field]}." if field in _HINTS else ""
        raise InvalidProblem(f"{field}: expected an instance of {names}, got {found}.{hint}")


def _check_count(field: str, value: Any, least: int) -> None:
    if not is_whole(value, least):
        raise InvalidProblem(f"{field}: expected a whole number, {least} or more, got {value!r}.")
