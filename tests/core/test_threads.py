"""Threads over items: the results of a plain loop, few items in memory, an end at once."""

import os
import signal
import threading
import time

import jax
import jax.numpy as jnp
import pytest

from jaxscp.core.threads import in_order

CTRL_C = 2.0  # s: within which an interruption ends the call


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_are_those_of_a_loop_in_its_order(workers):
    def slow_first(v):
        time.sleep(0.02 if v % 7 == 0 else 0.0)
        return v * v

    assert list(in_order(slow_first, range(40), workers)) == [v * v for v in range(40)]
    assert list(in_order(slow_first, [], workers)) == []


def test_items_are_drawn_as_they_are_needed():
    drawn = []
    items = (drawn.append(i) or i for i in range(1000))
    results = in_order(lambda v: v, items, workers=2, in_flight=4)
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    assert len(drawn) <= 3 + 4
    results.close()


def test_an_exception_of_an_item_is_raised_and_ends_the_rest():
    begun = []

    def fails(v):
        begun.append(v)
        if v == 3:
            raise ValueError("item 3")
        time.sleep(0.01)

    with pytest.raises(ValueError, match="item 3"):
        list(in_order(fails, range(1000), workers=2))
    assert len(begun) < 100


@pytest.fixture
def ctrl_c():
    """Ctrl-C raises, also where the tests run in the background of a shell, which makes it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_ends_it_at_once():
    began = time.monotonic()
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        list(in_order(lambda _: time.sleep(0.2), range(1000), workers=2))
    assert time.monotonic() - began < CTRL_C


def test_settings_of_the_calling_thread_hold():
    with jax.enable_x64(False):
        assert [str(v.dtype) for v in in_order(jnp.asarray, [0.5, 1.5], workers=2)] == ["float32"] * 2
