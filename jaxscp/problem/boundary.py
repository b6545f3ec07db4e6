"""Conditions at both ends: functions of the state and the time that are zero, with names and units of their rows."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.core.arrays import components, floats, is_number
from jaxscp.core.errors import InvalidProblem
from jaxscp.core.types import Scalar

END_TOLERANCE = 1e-3  # of a row, in its unit: error that counts as none


def length(rows: Float[Array, "rows"]) -> Scalar:
    """Euclidean norm."""
    return jnp.linalg.norm(rows)


class EndRows(eqx.Module):
    """Consecutive rows of a condition that a certificate measures together.

    Args:
        name: for reports.
        unit: of the error.
        count: number of rows.
        tolerance: error that counts as none; None is 1e-3, times the rows' typical size if the problem has a scale.
        error: from the rows to their error, by default their norm.
    """

    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="")
    count: int = eqx.field(static=True, default=1)
    tolerance: float | None = eqx.field(static=True, default=None)
    error: Callable[..., Scalar] = eqx.field(static=True, default=length)

    def __check_init__(self):
        if self.tolerance is not None and not (is_number(self.tolerance) and self.tolerance > 0.0):
            raise InvalidProblem(
                f"{self.name}: tolerance must be one positive number, is {self.tolerance!r}."
            )


class EndCondition(eqx.Module):
    """``function(state, time, parameters) = 0`` at one end of the trajectory.

    Linearised at the reference; a row that is zero everywhere is no condition.

    Args:
        function: pure; returns one axis of rows.
        parameters: a pytree of numbers and arrays.
        rows: names, units and tolerances; by default one group of all rows, named as the function.

    Example:
        >>> import jax.numpy as jnp, jaxscp
        >>> def meets(state, time, target):
        ...     return state[:2] - (target["position"] + time * target["velocity"])
        >>> target = {"position": jnp.zeros(2), "velocity": jnp.ones(2)}
        >>> docked = jaxscp.EndCondition(meets, target, rows=(jaxscp.EndRows("distance", "m", count=2),))
    """

    function: Callable[..., Any] = eqx.field(static=True)
    parameters: Any = ()
    rows: tuple[EndRows, ...] = ()

    def value(self, state: Float[Array, "states"], time: Scalar | float) -> Float[Array, "rows"]:
        """The rows."""
        return self.function(state, time, self.parameters)


class CoupledEnds(eqx.Module):
    """``function(first, last, time, parameters) = 0``: a condition on the states of both ends and the final time.

    Arguments are as of ``EndCondition``. The first state becomes a static state, so that stages stay a chain.
    """

    function: Callable[..., Any] = eqx.field(static=True)
    parameters: Any = ()
    rows: tuple[EndRows, ...] = ()

    def value(self, first: Array, last: Array, time: Scalar | float) -> Float[Array, "rows"]:
        """The rows."""
        return self.function(first, last, time, self.parameters)


class Boundary(eqx.Module):
    """Conditions at the start, at the end, and between both.

    Args:
        initial: at the start, where time is zero.
        final: at the end.
        coupled: on both; ``periodic()``, say.
    """

    initial: EndCondition
    final: EndCondition
    coupled: CoupledEnds | None = None


class _Components(eqx.Module):
    """The chosen components of the state, less the given values."""

    chosen: tuple[int, ...] = eqx.field(static=True)
    states: int = eqx.field(static=True)

    def __call__(self, state, time, value):
        if state.shape[0] != self.states:
            raise ValueError(
                f"fixed_state was given {self.states} values, but there are {state.shape[0]} states"
            )
        return components(state, self.chosen) - value


class _SameComponents(eqx.Module):
    """Change of the chosen components from the first state to the last."""

    chosen: tuple[int, ...] | None = eqx.field(static=True)

    def __call__(self, first, last, time, parameters):
        missing = [k for k in self.chosen or () if k >= first.shape[0]]
        if missing:
            raise InvalidProblem(
                f"periodic: component {missing[0]} of {first.shape[0]} states does not exist."
            )
        return components(last - first, self.chosen)


def fixed_state(
    values: Sequence[Any] | Array | np.ndarray,
    names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
    tolerance: float | None = None,
) -> EndCondition:
    """Components of the state at given values; None leaves a component free.

    Args:
        values: one for each component, numbers or None; or an array, which fixes all.
        names: of the components, for reports.
        units: of the components.
        tolerance: error of a component that counts as none.

    Raises:
        InvalidProblem: for a single number in place of a list, and for other numbers of names or units.

    Example:
        >>> import jaxscp
        >>> goal = jaxscp.fixed_state([6.0, 0.0, None], names=("x", "y", "heading"), units=("m", "m", "rad"))
        >>> [rows.name for rows in goal.rows]
        ['x', 'y']
    """
    if not isinstance(values, list | tuple) and np.ndim(values) == 0:
        raise InvalidProblem(
            f"fixed_state: expected one value for each component, [{values}] say, got {values!r}."
        )
    for field, texts in (("names", names), ("units", units)):
        if texts and len(texts) != len(values):
            raise InvalidProblem(f"fixed_state: {field} has {len(texts)} entries, values has {len(values)}.")
    chosen = tuple(i for i, v in enumerate(values) if v is not None)
    rows = tuple(
        EndRows(names[i] if names else f"x[{i}]", units[i] if units else "", 1, tolerance) for i in chosen
    )
    return EndCondition(_Components(chosen, len(values)), floats([values[i] for i in chosen]), rows)


def periodic(components: Sequence[int] | None = None, name: str = "period", unit: str = "") -> CoupledEnds:
    """The chosen components of the state are the same at both ends; all by default.

    Raises:
        InvalidProblem: a component is no number from 0 on, occurs twice, or is none of the state's.

    Example:
        >>> import jaxscp
        >>> free = jaxscp.fixed_state([None, None])
        >>> loop = jaxscp.Boundary(free, free, coupled=jaxscp.periodic())
    """
    chosen = None if components is None else tuple(components)
    if chosen is not None and (
        len({*chosen}) < len(chosen) or any(not isinstance(k, int) or k < 0 for k in chosen)
    ):
        raise InvalidProblem(
            f"periodic: different components are expected, numbers from 0 on, got {components!r}."
        )
    rows = () if chosen is None else (EndRows(name, unit, len(chosen)),)
    return CoupledEnds(_SameComponents(chosen), (), rows)


def fixed_values(condition: EndCondition, states: int) -> list[Any] | None:
    """What ``fixed_state`` was given, None where free; None for a condition given by another function."""
    if not isinstance(condition.function, _Components):
        return None
    if condition.function.states != states:
        raise InvalidProblem(
            f"fixed_state: {condition.function.states} values were given, but dynamics has {states} states."
        )
    values: list[Any] = [None] * states
    for number, component in enumerate(condition.function.chosen):
        values[component] = jax.tree.leaves(condition.parameters)[0][number]
    return values
