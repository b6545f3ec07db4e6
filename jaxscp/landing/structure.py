"""The parts of a mission: each of the class that its field names, down to arrays."""

import dataclasses
import functools
import types
import typing
from typing import Any

import equinox as eqx

from jaxscp.core.errors import InvalidScenario
from jaxscp.corridor.polytopes import Corridor
from jaxscp.landing.mission import Mission

_MAKERS = {
    "BodyState": "jaxscp.at_rest(position, yaw) makes one, and jaxscp.BodyState.of(x) of 13 numbers",
    "Components": "jaxscp.fixed(attitude=[1, 1, 0]), say, makes one",
    "Corridor": "jaxscp.corridor.connect(polytopes) and build_corridor make one",
    "Ellipsoids": "jaxscp.ellipsoids(centres, semi_axes) makes them",
    "Obstacles": "jaxscp.corridor.obstacles_near(corridor, cloud, radius) makes them",
    "FlightLimits": "jaxscp.flight_limits(speed=4.0), say, makes them, and jaxscp.flight_limits() none",
    "Weights": "jaxscp.Weights(control=1.0, time=0.0), say, makes them",
    "Airframe": "jaxscp.airframes has some",
}


def check_parts(mission: Mission) -> None:
    """Raise ``InvalidScenario`` for a part that is missing or of another class; the message names it.

    Values and shapes do not count: leaves may be traced, or ``jax.ShapeDtypeStruct``.
    """
    _check_part(mission, Mission, "scenario")


def _check_part(part: Any, expected: type, name: str) -> None:
    if not isinstance(part, expected):
        found = "None" if part is None else f"one of class {type(part).__name__}"
        if part is not None and hasattr(part, "dtype") and hasattr(part, "shape"):
            found = f"an array of shape {tuple(part.shape)}"
        hint = f"; {_MAKERS[expected.__name__]}" if expected.__name__ in _MAKERS else ""
        if expected is Corridor:
            hint += _search_hint(part)
        raise InvalidScenario(f"{name}: expected a part of class {expected.__name__}, got {found}{hint}.")
    for field, choices in _fields(expected):
        below = field if name == "scenario" else f"{name}.{field}"
        _check_field(getattr(part, field), choices, below)


def _search_hint(part: Any) -> str:
    """Words on the result of a search that is given in place of its corridor."""
    if part is None:
        return "; where build_corridor found no route, the message of its result says why"
    if not hasattr(part, "corridor"):
        return ""
    if part.corridor is None:
        return f"; this result holds none: {part.message}"
    return "; give the field corridor of this result: found.corridor"


@functools.cache
def _fields(expected: type) -> list[tuple[str, tuple[Any, ...]]]:
    """Fields of a class, each with the classes that its annotation allows; a check comes before every plan."""
    hints = typing.get_type_hints(expected)
    unions = (types.UnionType, typing.Union)
    choices = lambda hint: typing.get_args(hint) if typing.get_origin(hint) in unions else (hint,)  # noqa: E731
    return [(field.name, choices(hints[field.name])) for field in dataclasses.fields(expected)]


def _check_field(value: Any, choices: tuple[Any, ...], name: str) -> None:
    """Check a field by its annotation: a class of parts, or an array; or None where that is allowed."""
    if value is None and types.NoneType in choices:
        return
    expected = next(c for c in choices if c is not types.NoneType)
    if isinstance(expected, type) and issubclass(expected, eqx.Module):
        _check_part(value, expected, name)
    elif value is None:
        raise InvalidScenario(f"{name}: expected an array, got None.")
    elif not (hasattr(value, "dtype") and hasattr(value, "shape")):
        raise InvalidScenario(
            f"{name}: expected an array, got one of class {type(value).__name__}; wrap it in jnp.asarray(..., float)."
        )
