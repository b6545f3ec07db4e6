"""A user's function, known by what it computes.

JAX knows a function by its Python object, so that a lambda in a loop compiles in every turn. Here two functions are the
same if their value and their first and second directional derivatives lower to the same StableHLO text. A printed
jaxpr would not do: it hides constants of nested functions, and derivative rules.
"""

import dataclasses
import hashlib
import types
import warnings
from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer, eval_jaxpr
from jax.interpreters.partial_eval import dce_jaxpr

from jaxscp.core.jaxpr_key import HasRules, jaxpr_key
from jaxscp.core.outside import known_by_values

PACKAGE = __name__.partition(".")[0]
MOST_KNOWN = 512  # functions that are remembered
MOST_VERSIONS = 3  # programs of one line of code, before a warning


class Program:
    """A pure function of arrays: the last argument is a tuple of arrays. Equal to another if their digests are.

    Args:
        closed: the jaxpr; its constants that are tracers became ``captured`` ones.
        captured: positions of those constants; their values lead the last argument.
        shape: of the result.
        digest: of what it computes.
    """

    def __init__(self, closed: Any, captured: tuple[int, ...], shape: tuple[int, ...], digest: str):
        self.closed, self.captured, self.shape, self.digest = closed, captured, shape, digest

    def __call__(self, *arguments: Any) -> jax.Array:
        """The value."""
        *first, leaves = arguments
        count = len(self.captured)
        flat = [
            jnp.asarray(v, a.dtype)
            for v, a in zip([*first, *leaves[count:]], self.closed.in_avals, strict=True)
        ]
        return jnp.asarray(self.evaluate(leaves[:count], flat))

    def evaluate(self, captured: Sequence[Any], flat: Sequence[Any]) -> Any:
        """The value, from the captured constants and the leaves of all arguments."""
        constants = list(self.closed.consts)
        for position, value in zip(self.captured, captured, strict=True):
            constants[position] = value
        return eval_jaxpr(self.closed.jaxpr, constants, *flat)[0]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Program) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        return f"Program({self.digest[:8]})"


def identify(function: Callable[..., Any], *arguments: Any) -> tuple[Program, tuple]:
    """The function as a program, and the tracers that it closes over.

    A function that reads a changed value is another program. So it is traced at every call, unless its code and all
    values that it reads can be compared. It is lowered only if no known one has the same jaxpr.

    Args:
        function: pure; returns one array or number.
        arguments: examples, ``jax.ShapeDtypeStruct`` will do; the last one is a pytree of parameters. The program takes
            its leaves, after the tracers.

    Raises:
        TypeError: if it returns no array.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from jaxscp.core.program import identify
        >>> x = jnp.ones(2)
        >>> one, _ = identify(lambda x, p: p["k"] * x, x, {"k": 2.0})
        >>> other, _ = identify(lambda y, q: q["k"] * y, x, {"k": 3.0})
        >>> one == other, one(x, (5.0,)).tolist()
        (True, [5.0, 5.0])
    """
    shapes = jax.tree.map(lambda v: jax.ShapeDtypeStruct(jnp.shape(v), jnp.result_type(v)), arguments)
    leaves, tree = jax.tree.flatten(shapes)
    values = known_by_values(function)
    whole = (values, tree, tuple((v.shape, str(v.dtype)) for v in leaves))
    if values is not None and whole in _by_values:
        return _by_values[whole], ()
    closed, out = traced(function, *shapes)
    captured = tuple(i for i, c in enumerate(closed.consts) if isinstance(c, Tracer))
    program = Program(closed, captured, out.shape, "")
    tracers = tuple(closed.consts[i] for i in captured)
    if tracers:  # they end with the transformation that made them
        program.digest = _digest(program, leaves, tracers)
        return program, tracers
    program = _known_or_lowered(program, leaves)
    if values is not None:
        _remember(_by_values, whole, program)
    _warn_of_versions(function, program)
    return program, ()


def traced(function: Callable[..., Any], *shapes: Any) -> Any:
    """A function's jaxpr and the shape of its value, in floats."""
    return jax.make_jaxpr(_returning_floats(function), return_shape=True)(*shapes)


def reads(function: Callable[..., Any], argument: int, *arguments: Any) -> bool:
    """Whether a function's value depends on one of its arguments, which is a single array.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.core.program import reads
        >>> reads(lambda x, t: x + 0.0 * t, 1, jnp.ones(2), 0.0), reads(lambda x, t: 2.0 * x, 1, jnp.ones(2), 0.0)
        (True, False)
    """
    closed = jax.make_jaxpr(function)(*arguments)
    before = len(jax.tree.leaves(arguments[:argument]))
    _, used = dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars))
    return bool(used[before])


def of_this_package(function: Callable[..., Any]) -> bool:
    """Whether a function is known by its name or digest already."""
    if isinstance(function, Program):
        return True
    cls = function if isinstance(function, types.FunctionType) else type(function)
    module = cls.__module__ or ""  # None for a function of a namespace without a name
    ours = module.partition(".")[0] == PACKAGE and "<" not in cls.__qualname__
    return ours and not jax.tree.leaves(function if cls is not function else ())


def wholly_of_this_package(part: Any) -> bool:
    """Whether a module is made of this package's classes and functions alone."""
    if isinstance(part, eqx.Module):
        ours = type(part).__module__.partition(".")[0] == PACKAGE
        fields = (getattr(part, field.name) for field in dataclasses.fields(part))
        return ours and all(map(wholly_of_this_package, fields))
    if isinstance(part, jax.Array | int | float | str | None):
        return True
    if isinstance(part, tuple | list):
        return all(map(wholly_of_this_package, part))
    return callable(part) and of_this_package(part)


_by_values: dict[Hashable, Program] = {}
_by_jaxpr: dict[Hashable, Program] = {}
_versions: dict[Hashable, set[str]] = defaultdict(set)


def _known_or_lowered(program: Program, leaves: list) -> Program:
    """A known program with the same jaxpr, or this one with its digest."""
    try:
        key = jaxpr_key(program.closed)
    except HasRules:  # the jaxpr of the derivatives shows them
        derivatives, examples = _derivatives(program, leaves, ())
        try:
            key = jaxpr_key(jax.make_jaxpr(derivatives)(*examples))
        except HasRules:
            key = None
    if key is not None and key in _by_jaxpr:
        return _by_jaxpr[key]
    program.digest = _digest(program, leaves, ())
    if key is not None:
        _remember(_by_jaxpr, key, program)
    return program


def _remember(known: dict[Hashable, Program], key: Hashable, program: Program) -> None:
    if len(known) >= MOST_KNOWN:
        known.clear()
    known[key] = program


def _returning_floats(function: Callable[..., Any]) -> Callable[..., jax.Array]:
    def floating(*arguments):
        value = function(*arguments)
        if isinstance(value, list | tuple | dict) or value is None:
            raise TypeError(
                f"returns a {type(value).__name__}; return one array, jnp.stack([...]) or jnp.concatenate([...]), say"
            )
        if jnp.issubdtype(jnp.result_type(value), jnp.bool_):  # it would be zero or one, and never negative
            raise TypeError("returns booleans; write x < 1 as the number 1 - x, say, which changes with x")
        return jnp.asarray(value, jnp.result_type(float))

    return floating


def _derivatives(program: Program, leaves: list, tracers: tuple) -> tuple[Callable[..., Any], tuple]:
    """A function that gives the value and its first and second directional derivatives, and its arguments' shapes."""
    count = len(tracers)
    values = [*(jax.ShapeDtypeStruct(v.shape, v.dtype) for v in tracers), *leaves]
    moving = [i for i, v in enumerate(values) if jnp.issubdtype(v.dtype, jnp.inexact)]

    def derivatives(values, first, second):
        def moved(*floats):
            whole = list(values)
            for i, v in zip(moving, floats, strict=True):
                whole[i] = v
            return program.evaluate(whole[:count], whole[count:])

        slope = lambda *floats: jax.jvp(moved, floats, first)  # noqa: E731
        return jax.jvp(slope, tuple(values[i] for i in moving), second)

    directions = tuple(values[i] for i in moving)
    return derivatives, (values, directions, directions)


def _digest(program: Program, leaves: list, tracers: tuple) -> str:
    """Hash of the lowered value and its directional derivatives, and of constants that JAX passes beside the text."""
    derivatives, examples = _derivatives(program, leaves, tracers)
    text = jax.jit(derivatives).lower(*examples).as_text()
    digest = hashlib.sha256(text.encode())
    for constant in program.closed.consts:
        if not isinstance(constant, Tracer):
            digest.update(np.asarray(constant).tobytes())
    digest.update(repr(program.captured).encode())
    return digest.hexdigest()


def _warn_of_versions(function: Any, program: Program) -> None:
    """Warn where one line of code makes a new program for every value that it closes over."""
    code = getattr(function, "__code__", None)
    ours = (getattr(function, "__module__", None) or "").partition(".")[0] == PACKAGE
    if code is None or ours or program.digest in _versions[code]:
        return
    versions = _versions[code]
    versions.add(program.digest)
    if len(versions) == MOST_VERSIONS + 1:
        warnings.warn(
            f"jaxscp: {function.__qualname__} (line {code.co_firstlineno}) has made {len(versions)} programs, and each "
            "compiles anew. If it closes over a number that varies, pass the number in parameters.",
            stacklevel=2,
        )
