"""A traced function as a key: two equal keys are the same instructions on the same constants."""

import hashlib
from collections.abc import Callable, Hashable
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal


class HasRules(Exception):
    """A function with derivative rules of its own, which its jaxpr does not show."""


def jaxpr_key(closed: ClosedJaxpr) -> Hashable:
    """Instructions and constants, those of inner functions too.

    Raises:
        HasRules: of derivatives. Trace the derivatives in place of the value.

    Example:
        >>> import jax
        >>> from jaxscp.core.jaxpr_key import jaxpr_key
        >>> keys = [jaxpr_key(jax.make_jaxpr(lambda x, c=c: c * x)(1.0)) for c in (2.0, 2.0, 3.0)]
        >>> keys[0] == keys[1], keys[0] == keys[2]
        (True, False)
    """
    return _jaxpr(closed.jaxpr), tuple(map(_array, closed.consts))


def _jaxpr(jaxpr: Jaxpr) -> Hashable:
    numbers = {v: i for i, v in enumerate([*jaxpr.constvars, *jaxpr.invars])}

    def atom(v: Any) -> Hashable:
        if isinstance(v, Literal):
            return _array(v.val), v.aval
        return numbers.setdefault(v, len(numbers)), v.aval

    first = tuple(map(atom, [*jaxpr.constvars, *jaxpr.invars]))
    instructions = tuple(
        (e.primitive, *map(_atoms(atom), (e.invars, e.outvars)), _parameter(e.params)) for e in jaxpr.eqns
    )
    return first, instructions, _atoms(atom)(jaxpr.outvars)


def _atoms(atom: Callable[[Any], Hashable]) -> Callable[[Any], Hashable]:
    return lambda variables: tuple(map(atom, variables))


def _parameter(value: Any) -> Hashable:
    """Of an instruction."""
    if isinstance(value, ClosedJaxpr):
        return jaxpr_key(value)
    if isinstance(value, Jaxpr):
        return _jaxpr(value)
    if isinstance(value, tuple | list):
        return type(value), tuple(map(_parameter, value))
    if isinstance(value, dict):
        return tuple((name, _parameter(v)) for name, v in sorted(value.items()))
    if isinstance(value, float | np.ndarray | jax.Array):
        return _array(value)
    if callable(value) and not isinstance(value, type):
        raise HasRules
    try:
        hash(value)
    except TypeError:
        return repr(value)
    return type(value), value


def _array(value: Any) -> Hashable:
    """An array or a number, by a hash of its bytes: it may be large."""
    if isinstance(value, jax.Array) and jax.dtypes.issubdtype(value.dtype, jax.dtypes.prng_key):
        value = jax.random.key_data(value)
    value = np.asarray(value)
    return value.shape, str(value.dtype), hashlib.sha256(value.tobytes()).digest()
