"""Results of traces that are made once for all pytrees of one structure.

A trace in Python takes a second where its jaxpr, once made, takes milliseconds.
"""

import threading
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.core
import jax.extend.core
import numpy as np

ENTRIES = 256


class _Trace(NamedTuple):
    """Results of a function for tracers of one structure."""

    static: Any
    arrays: jax.extend.core.ClosedJaxpr
    structure: Any
    """Of the pytree of arrays."""


_TRACES: dict[Hashable, _Trace] = {}
"""The oldest first."""
_LOCK = threading.Lock()  # threads may compile at once


def traced_once(function: Callable[..., tuple[Any, Any]], tree: Any, *options: Hashable) -> tuple[Any, Any]:
    """``function(tree, *options)``, for which the function is called only if it has not seen such a tree before.

    Args:
        function: a pure function; returns something static, and a pytree of arrays computed from the tree's.
        tree: a pytree. Tracers may have other values at the next call; all else is a constant.
        options: further arguments.
    """
    tracers, constants = eqx.partition(tree, _is_tracer)
    leaves = jax.tree.leaves(tracers)
    key = _key(function, tree, options)
    trace = None if key is None else _TRACES.get(key)
    if trace is None:
        trace = _traced(lambda tracers: function(eqx.combine(tracers, constants), *options), tracers)
        if key is not None and not any(map(_is_tracer, trace.arrays.consts)):
            _keep(key, trace)
    found = jax.extend.core.jaxpr_as_fun(trace.arrays)(*leaves)
    return trace.static, jax.tree.unflatten(trace.structure, found)


def _keep(key: Hashable, trace: _Trace) -> None:
    with _LOCK:
        _TRACES[key] = trace
        if len(_TRACES) > ENTRIES:
            del _TRACES[next(iter(_TRACES))]


def _traced(function: Callable[[Any], tuple[Any, Any]], tracers: Any) -> _Trace:
    static: list[Any] = []

    def arrays(tracers):
        found, arrays = function(tracers)
        static.append(found)
        return arrays

    jaxpr, shapes = jax.make_jaxpr(arrays, return_shape=True)(tracers)
    return _Trace(static[0], jaxpr, jax.tree.structure(shapes))


def _key(function: Callable[..., Any], tree: Any, options: Hashable) -> Hashable | None:
    """Key of a trace; None if the tree has a leaf that cannot be one."""
    leaves, structure = jax.tree.flatten(tree)
    try:
        key = function, options, structure, tuple(map(_leaf_key, leaves))
        hash(key)
    except TypeError:  # such as a list, or the key of a random generator
        return None
    return key


def _leaf_key(leaf: Any) -> Hashable:
    if _is_tracer(leaf):
        return jax.typeof(leaf)
    if isinstance(leaf, np.ndarray | jax.Array):
        array = np.asarray(leaf)
        return array.shape, array.dtype, array.tobytes()
    return type(leaf), leaf


def _is_tracer(leaf: Any) -> bool:
    return isinstance(leaf, jax.core.Tracer)
