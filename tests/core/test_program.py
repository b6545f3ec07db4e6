"""A function is known by what it computes: whatever value it reads, and however, a changed one is another program."""

import functools
import types

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.core.outside import known_by_values
from jaxscp.core.program import identify

X = jnp.arange(1.0, 3.0)
GAIN, TABLE, STORE = 1.0, {"gain": [1.0]}, types.SimpleNamespace(gain=1.0)
MODULE = types.ModuleType("of_the_user")


def _set(value):
    """Change every place where a function below finds its gain."""
    global GAIN
    GAIN = TABLE["gain"][0] = STORE.gain = MODULE.gain = value


def _helper():
    return GAIN


class Held:
    """A gain as an attribute."""

    def __init__(self):
        self.gain = GAIN

    def __call__(self, x, p):
        """The product."""
        return self.gain * x

    def method(self, x, p):
        """The same."""
        return self.gain * x


class OfClass(eqx.Module):
    """Reads a global in its call."""

    def __call__(self, x, p):
        """The product."""
        return GAIN * x


@jax.custom_jvp
def _with_rule(x):
    return x


_with_rule.defjvp(lambda primals, tangents: (primals[0], GAIN * tangents[0]))


def _wrapped(function):
    @functools.wraps(function)
    def wrapper(x, p):
        return GAIN * function(x, p)

    return wrapper


def _keyword(x, p, *, gain=1.0):
    return gain * x


HELD = Held()
READERS = {
    "global": lambda x, p: GAIN * x,
    "helper": lambda x, p: _helper() * x,
    "nested lambda": lambda x, p: (lambda v: GAIN * v)(x),
    "list in a dict": lambda x, p: TABLE["gain"][0] * x,
    "attribute": lambda x, p: STORE.gain * x,
    "module": lambda x, p: MODULE.gain * x,
    "wrapper": _wrapped(lambda x, p: x),
    "wrapper of a library's": functools.wraps(jnp.sin)(lambda x, p: GAIN * jnp.sin(x)),
    "partial": functools.partial(lambda gain, x, p: GAIN * gain * x, 1.0),
    "module's call": OfClass(),
    "derivative rule": lambda x, p: _with_rule(x),
    "inside a loop": lambda x, p: jax.lax.fori_loop(0, 2, lambda _, v: GAIN * v, x),
}


def _program(function):
    return identify(function, X, 0.0)[0]


@pytest.mark.parametrize("how", READERS)
def test_a_changed_value_is_another_program(how):
    function = READERS[how]
    _set(1.0)
    first = _program(function)
    assert _program(function) == first
    _set(2.0)
    changed = _program(function)
    assert changed != first
    if how != "derivative rule":
        np.testing.assert_array_equal(changed(X, (0.0,)), function(X, 0.0))
    _set(1.0)
    assert _program(function) == first


def test_changed_attributes_of_kept_objects_are_other_programs():
    HELD.gain = 1.0
    method = HELD.method
    first = _program(HELD), _program(method), _program(_keyword)
    assert first[0] == first[1] == first[2]
    HELD.gain, _keyword.__kwdefaults__["gain"] = 3.0, 3.0
    for function in (HELD, method, _keyword):
        assert _program(function) != first[0]
        np.testing.assert_array_equal(_program(function)(X, (0.0,)), 3.0 * X)


def test_constants_that_share_a_shape_are_told_apart():
    table = np.ones(2)
    read = lambda x, p: jax.jit(lambda v: v * jnp.asarray(table))(x)  # noqa: E731
    first = _program(read)
    table[0] = 5.0
    np.testing.assert_array_equal(_program(read)(X, (0.0,)), [5.0, 2.0])
    assert _program(read) != first


def test_numbers_that_are_equal_but_not_alike_are_told_apart():
    one = lambda value: lambda x, p: value * x.astype(int)  # noqa: E731
    assert known_by_values(one(1)) != known_by_values(one(True)) != known_by_values(one(1.0))
    assert known_by_values(one(0.0)) != known_by_values(one(-0.0))
    assert known_by_values(one(2.0)) == known_by_values(one(2.0))


def test_a_function_in_a_loop_is_lowered_once(monkeypatch):
    lowered = []
    monkeypatch.setattr("jaxscp.core.program._digest", lambda *_: lowered.append(1) or "digest of one")
    for _ in range(5):
        _program(lambda x, p: jnp.sin(x) + STORE.gain + 7.125)
    assert len(lowered) == 1


def test_a_function_that_calls_itself_is_known():
    def power(x, p, times=3):
        return x if times == 0 else x * power(x, p, times - 1)

    assert known_by_values(power) == known_by_values(power) is not None
    np.testing.assert_array_equal(_program(power)(X, (0.0,)), X**4)
