"""Arrays from plain numbers and lists, without compilation."""

import operator
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

PRECISION = (
    "precision: jaxscp solves in float64, which JAX has switched off. Put jax.config.update('jax_enable_x64', True) at "
    "the start of the program, or set JAX_ENABLE_X64=1."
)


def namespace(*values: Any) -> Any:
    """``jax.numpy`` where any of these pytrees is traced, else ``numpy``.

    Known numbers need no JAX, which would compile every operation: to build a scenario would take longer than to plan
    it. ``jnp.asarray`` makes arrays of JAX.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from jaxscp.core.arrays import namespace
        >>> namespace([0.0, 1.0], jnp.ones(3)).__name__
        'numpy'
        >>> int(jax.jit(lambda v: namespace(v).argmax(v))(jnp.arange(3)))
        2
    """
    return jnp if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values)) else np


def floats(value: Any) -> jax.Array:
    """Numbers, arrays, or nested lists of them, as an array of floats."""
    return jnp.asarray(namespace(value).asarray(value, float))


def numbers(name: str, value: Any, expected: str = "numbers") -> Any:
    """Numbers as an array of floats, traced or of NumPy. Text is refused, also where it spells a number.

    Args:
        name: of the numbers, for the message.
        value: a number, an array, or nested lists.
        expected: kind of numbers, for the message.

    Raises:
        ValueError: these are no numbers.

    Example:
        >>> from jaxscp.core.arrays import numbers
        >>> float(numbers("mass", 1))
        1.0
        >>> numbers("mass", "0.25")
        Traceback (most recent call last):
        ...
        ValueError: mass: expected numbers, got '0.25'
    """
    xp = namespace(value)
    try:
        if value is None or _is_text(value):
            raise TypeError("no numbers")
        return xp.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected {expected}, got {value!r}") from error


def _is_text(value: Any) -> bool:
    """Whether NumPy would read numbers out of strings."""
    return namespace(value) is np and np.asarray(value).dtype.kind in "US"


def triple(name: str, value: Any) -> Any:
    """Three numbers as an array of floats, traced or of NumPy.

    Args:
        name: of the numbers, for the message.
        value: the numbers.

    Raises:
        ValueError: these are no three numbers.

    Example:
        >>> from jaxscp.core.arrays import triple
        >>> triple("position", [0, 1, 2]).tolist()
        [0.0, 1.0, 2.0]
    """
    array = numbers(name, value, "three numbers")
    if array.shape != (3,):
        raise ValueError(f"{name}: expected three numbers, got shape {array.shape}")
    return array


def is_number(value: Any) -> bool:
    """Whether a known value is one real number: Python's, NumPy's, or an array without axes.

    Example:
        >>> from jaxscp.core.arrays import is_number
        >>> is_number(2), is_number("2"), is_number([2.0])
        (True, False, False)
    """
    return np.ndim(value) == 0 and np.asarray(value).dtype.kind in "iuf"


def is_whole(value: Any, least: int) -> bool:
    """Whether a known value is a whole number of the type of one, and not less.

    Example:
        >>> from jaxscp.core.arrays import is_whole
        >>> is_whole(2, 1), is_whole(0, 1), is_whole(2.0, 1), is_whole(True, 1)
        (True, False, False, False)
    """
    try:
        return not isinstance(value, bool) and operator.index(value) >= least
    except TypeError:
        return False


def check_whole(name: str, value: Any, least: int) -> None:
    """Raise a ``ValueError`` if a known value is no whole number, or less.

    Example:
        >>> from jaxscp.core.arrays import check_whole
        >>> check_whole("steps", 2.5, 1)
        Traceback (most recent call last):
        ...
        ValueError: steps: expected a whole number, 1 or more, got 2.5
    """
    if not is_whole(value, least):
        raise ValueError(f"{name}: expected a whole number, {least} or more, got {value!r}")


def as_floats(value: Any) -> Any:
    """Plain numbers, NumPy arrays and lists as an array of floats; arrays of JAX, None, text and others stay.

    Example:
        >>> import numpy as np
        >>> from jaxscp.core.arrays import as_floats
        >>> as_floats(np.float64(2.0)).shape, as_floats([1, 2]).tolist(), as_floats(None)
        ((), [1.0, 2.0], None)
    """
    plain = isinstance(value, (int, float, np.number, np.ndarray, list, tuple)) and not isinstance(
        value, bool
    )
    return floats(value) if plain and not _is_text(value) else value


UNIT = 1e-12  # difference of a squared length from one below which a vector counts as a unit vector


def unit_lengths(vectors: Any) -> Any:
    """Numbers to divide vectors by, so that they have unit length: one for unit vectors and for zero.

    A vector of unit length to rounding keeps its bits, so that scaling twice is scaling once. Scaling still has its
    derivative there: a change along a direction is no change of the direction.

    Args:
        vectors: (..., components) arrays, traced or not.

    Returns:
        (...) lengths.

    Example:
        >>> import numpy as np
        >>> from jaxscp.core.arrays import unit_lengths
        >>> unit_lengths(np.array([[3.0, 4.0], [0.0, 1.0], [0.0, 0.0]])).tolist()
        [5.0, 1.0, 1.0]
    """
    xp = namespace(vectors)
    vectors = xp.asarray(vectors)
    squares = xp.sum(vectors * vectors, axis=-1)
    lengths = xp.sqrt(xp.where(squares > 0, squares, 1.0))
    change = (
        lengths - jax.lax.stop_gradient(lengths) if xp is jnp else 0.0
    )  # zero, with the derivative of scaling
    return xp.where(xp.abs(squares - 1.0) <= UNIT, 1.0 + change, lengths)


def components(vector: jax.Array, chosen: Sequence[int] | None) -> jax.Array:
    """Chosen components of a vector, or all (None), by slices: compiled backends take no array of indices.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.core.arrays import components
        >>> components(jnp.array([1.0, 2.0, 3.0]), (0, 2)).tolist()
        [1.0, 3.0]
    """
    if chosen is None:
        return vector
    return jnp.stack([vector[i] for i in chosen]) if chosen else jnp.zeros(0, vector.dtype)


def double_precision() -> bool:
    """Whether JAX computes in float64, as all of this library does."""
    return bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]
