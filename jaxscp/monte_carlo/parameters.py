"""A parameter: a leaf of a pytree, and the distribution of its value."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.core.arrays import namespace
from jaxscp.monte_carlo.distributions import Distribution
from jaxscp.monte_carlo.errors import InvalidStudy


@runtime_checkable
class Change(Protocol):
    """Changes a number or an array of the base by a drawn value."""

    def __call__(self, base: Any, value: Any) -> Any:
        """The new number or array."""
        ...


@dataclasses.dataclass(frozen=True)
class Set:
    """The value replaces the base's."""

    def __call__(self, base: Any, value: Any) -> Any:
        """See ``Change``."""
        xp = namespace(base, value)
        return xp.broadcast_to(xp.asarray(value, float), xp.shape(base))


@dataclasses.dataclass(frozen=True)
class Add:
    """The value is added to the base's."""

    def __call__(self, base: Any, value: Any) -> Any:
        """See ``Change``."""
        return base + value


@dataclasses.dataclass(frozen=True)
class Scale:
    """The base's is multiplied by the value."""

    def __call__(self, base: Any, value: Any) -> Any:
        """See ``Change``."""
        return base * value


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A leaf that varies.

    Args:
        where: a function from the pytree to the leaf, as of ``equinox.tree_at``; or the leaf's dotted path.
        distribution: of its value.
        name: in tables; by default the path.
        unit: in tables.
        index: of the entry that varies, for a leaf that is an array; None for all entries together.
        change: ``Set()``, ``Add()`` or ``Scale()``.

    Example:
        >>> from jaxscp import monte_carlo as mc
        >>> mass = mc.Parameter(lambda s: s.airframe.body.mass, mc.Normal(0.93, 0.02), "mass", "kg")
        >>> east = mc.Parameter("goal.position", mc.Normal(0.0, 0.1), "east", "m", index=0, change=mc.Add())
    """

    where: Callable[[Any], Any] | str
    distribution: Distribution
    name: str = ""
    unit: str = ""
    index: int | tuple[int, ...] | None = None
    change: Change = Set()

    def resolved(self, base: Any) -> "Parameter":
        """The same parameter by its path, checked against the pytree.

        Raises:
            InvalidStudy: if there is no such leaf, or it is no float.
        """
        path = self.where if isinstance(self.where, str) else path_of(base, self.where)
        leaves = dict(dotted_leaves(base))
        if path not in leaves:
            near = [name for name in leaves if name.split(".")[-1] == path.split(".")[-1]]
            raise InvalidStudy(
                f"parameter {path!r}: the base has no such leaf (a value of None is none); "
                f"there are {', '.join((near or list(leaves))[:8]) or 'none'}."
            )
        found = Parameter(path, self.distribution, self.name or path, self.unit, self.index, self.change)
        found.check(leaves[path])
        return found

    def check(self, leaf: Any) -> None:
        """Raise ``InvalidStudy`` if the leaf is no float, or has no such entry."""
        about = f"parameter {self.name!r}"
        if not isinstance(self.distribution, Distribution):
            raise InvalidStudy(
                f"{about}: expected a distribution, Normal(...) say, got {self.distribution!r}."
            )
        whole = isinstance(leaf, int) and not isinstance(leaf, bool)
        dtype = getattr(leaf, "dtype", None) or np.asarray(leaf).dtype
        if not whole and not np.issubdtype(dtype, np.floating):
            raise InvalidStudy(f"{about}: its leaf holds {dtype}; only floats vary.")
        try:
            np.empty(np.shape(leaf))[() if self.index is None else self.index]
        except IndexError as error:
            raise InvalidStudy(
                f"{about}: no entry {self.index} in a leaf of shape {np.shape(leaf)}."
            ) from error
        if self.index is None and np.ndim(leaf) > 0 and self.change == Set():
            raise InvalidStudy(
                f"{about}: its leaf has the shape {np.shape(leaf)}. Give index= for one entry, or change=Scale() or "
                "Add() for all of them together."
            )

    def applied(self, leaf: Any, value: Any) -> Any:
        """The leaf with a drawn value."""
        xp = namespace(leaf, value)
        array = xp.asarray(leaf, float)
        index = () if self.index is None else self.index
        new = self.change(array[index], value)
        if xp is jnp:
            return array.at[index].set(new)
        array = array.copy()
        array[index] = new
        if isinstance(leaf, int | float) and not isinstance(leaf, np.generic):
            return float(array)
        return jnp.asarray(array) if isinstance(leaf, jax.Array) else array


def path_of(base: Any, where: Callable[[Any], Any]) -> str:
    """The dotted path of the leaf that a function picks.

    Raises:
        InvalidStudy: if it picks no leaf.

    Example:
        >>> path_of({"wind": {"east": 1.0}}, lambda tree: tree["wind"]["east"])
        'wind.east'
    """
    names = [name for name, _ in dotted_leaves(base)]
    marks = [_Mark(name) for name in names]
    marked = jax.tree.unflatten(jax.tree.structure(base), marks)
    try:
        found = where(marked)
    except (AttributeError, KeyError, IndexError, TypeError) as error:
        raise InvalidStudy(f"parameter: its function fails on the base: {error}.") from error
    if not isinstance(found, _Mark):
        raise InvalidStudy(
            f"parameter: its function picks a {type(found).__name__}, not one leaf. Pick a number or an array, and "
            "one entry of it by index=."
        )
    return found.name


def dotted_leaves(tree: Any) -> Iterator[tuple[str, Any]]:
    """Leaves of a pytree with their dotted paths, ``airframe.body.mass`` or ``constraints.0.parameters`` say."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        yield jax.tree_util.keystr(path, simple=True, separator="."), leaf


@dataclasses.dataclass(frozen=True)
class _Mark:
    """Stands for a leaf."""

    name: str


def places_of(base: Any, parameters: Sequence[Parameter]) -> tuple[int, ...]:
    """Numbers of the parameters' leaves among the leaves of the base."""
    leaves, drawn = dict(dotted_leaves(base)), set()
    for parameter in parameters:
        shape = np.shape(leaves[str(parameter.where)])
        chosen = np.arange(np.prod(shape, dtype=int)).reshape(shape)[
            () if parameter.index is None else parameter.index
        ]
        entries = {(parameter.where, int(entry)) for entry in np.ravel(chosen)}
        if parameter.change == Set() and entries & drawn:
            raise InvalidStudy(
                f"parameter {parameter.name!r}: sets an entry of {parameter.where} that an earlier parameter changes, "
                "which would have no effect. Give it change=Add() or Scale(), or another entry by index=."
            )
        drawn |= entries
    numbers = {name: i for i, name in enumerate(leaves)}
    return tuple(numbers[str(parameter.where)] for parameter in parameters)


def inserted(base: Any, parameters: Sequence[Parameter], places: tuple[int, ...], values: Any) -> Any:
    """The base with drawn values.

    Args:
        base: a pytree.
        parameters: resolved.
        places: from ``places_of``.
        values: (parameters,), in their order; may be traced.
    """
    leaves, tree = jax.tree.flatten(base)
    for parameter, place, value in zip(parameters, places, values, strict=True):
        leaves[place] = parameter.applied(leaves[place], value)
    return jax.tree.unflatten(tree, leaves)
