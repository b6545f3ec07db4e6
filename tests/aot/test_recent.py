"""Things made once and held for a while, whoever asks; room for compiled programs."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from jaxscp.aot import mappings
from jaxscp.aot.recent import Recent


def test_the_last_ones_asked_for_are_held():
    made, recent = [], Recent(2)
    ask = lambda key: recent.get(key, lambda: made.append(key) or f"made of {key}")  # noqa: E731
    assert [ask(1), ask(2), ask(1), ask(3)] == ["made of 1", "made of 2", "made of 1", "made of 3"]
    assert made == [1, 2, 3]
    assert [recent.known(key) for key in (1, 2, 3)] == ["made of 1", None, "made of 3"]
    recent.clear()
    assert recent.known(1) is None


def test_threads_that_ask_together_get_one():
    made, recent, together = [], Recent(4), threading.Barrier(6)

    def make(key):
        time.sleep(0.05)
        made.append(key)
        return object()

    def ask(key):
        together.wait()
        return recent.get(key, lambda: make(key))

    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(ask, [0, 1] * 3))
    assert sorted(made) == [0, 1]
    assert len(set(map(id, found))) == 2


def test_one_that_fails_is_tried_again():
    recent = Recent(2)
    with pytest.raises(ZeroDivisionError):
        recent.get(0, lambda: 1 / 0)
    assert recent.get(0, lambda: "made") == "made"


@pytest.mark.skipif(not mappings.limit(), reason="this system has no limit of mappings")
def test_programs_are_dropped_and_then_refused_before_the_limit():
    dropped = []
    drop = lambda: dropped.append(True)  # noqa: E731
    mappings.make_room(drop)
    assert 0 < mappings.count() < mappings.limit()
    assert not dropped
    with pytest.raises(mappings.TooManyPrograms, match=r"memory mappings.*jax\.clear_caches\(\)"):
        mappings.make_room(drop, most=mappings.count() // 2)
    assert dropped
