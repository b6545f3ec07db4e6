"""Batched loops: each batch element has the same result as alone, and is not stepped after its end."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscp.core import batching

ROUNDING = 1e-14  # relative: a batch may fuse a product and a sum, and one element alone may not
FULL = 8  # batch elements of a chunk
LARGEST = 3 * FULL + 5  # batch elements: several chunks, and one that is not full


@pytest.fixture(params=[batching.ALONE, (FULL,)], ids=["alone", "in_chunks"])
def chunks(request, monkeypatch):
    """Batch elements one after the other, as on a CPU, and in chunks, as elsewhere."""
    monkeypatch.setitem(batching.CHUNK, "cpu", request.param)


@pytest.fixture
def in_chunks(monkeypatch):
    """Chunks, as on devices other than CPUs."""
    monkeypatch.setitem(batching.CHUNK, "cpu", (FULL,))


def grow(factor, shift, times, start):
    """``times`` steps of v -> factor v + shift."""

    def step(fixed, state):
        left, v = state
        return left - 1, fixed["factor"] * v + fixed["shift"]

    fixed = {"factor": factor, "shift": shift, "name": "no array"}
    return batching.while_loop(lambda state: state[0] > 0, step, fixed, (times, start))


def count_down(times, stepped, ordered=False):
    """``times`` steps; ``stepped`` gets what is left before each."""

    def step(_, left):
        jax.debug.callback(lambda left: stepped.append(int(left)), left, ordered=ordered)
        return left - 1

    return batching.while_loop(lambda left: left > 0, step, None, times)


def by_hand(factor, shift, times, start):
    v = np.array(start)
    for _ in range(int(times)):
        v = factor * v + shift
    return v


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 30), min_size=1, max_size=LARGEST))
def test_every_element_ends_where_it_would_alone(counts):
    times = jnp.zeros(LARGEST, int).at[: len(counts)].set(jnp.array(counts))  # one shape, one compilation
    factor, start = jnp.linspace(0.9, 1.1, LARGEST), jnp.arange(LARGEST * 2.0).reshape(-1, 2)
    left, v = BATCHED(factor, 0.1, times, start)
    np.testing.assert_array_equal(left, 0)
    for i in range(LARGEST):
        np.testing.assert_allclose(v[i], by_hand(factor[i], 0.1, times[i], start[i]), rtol=ROUNDING)


BATCHED = jax.jit(jax.vmap(grow, in_axes=(0, None, 0, 0)))


@pytest.mark.parametrize("sizes", [(8, 2), (5, 3), (40, 3)])
def test_the_few_that_are_left_are_stepped_by_smaller_chunks(monkeypatch, sizes):
    monkeypatch.setitem(batching.CHUNK, "cpu", sizes)
    rounds = [8 * [3] + 3 * [1] + 12 * [2], LARGEST * [1], [0] * (LARGEST - 1) + [2]]
    factor, start = jnp.linspace(0.9, 1.1, LARGEST), jnp.arange(LARGEST * 2.0).reshape(-1, 2)
    run = jax.jit(lambda *given: jax.vmap(grow, in_axes=(0, None, 0, 0))(*given))  # compiles for these sizes
    for counts in rounds:
        times = jnp.zeros(LARGEST, int).at[: len(counts)].set(jnp.array(counts))
        left, v = run(factor, 0.1, times, start)
        np.testing.assert_array_equal(left, 0)
        for i in range(LARGEST):
            np.testing.assert_allclose(v[i], by_hand(factor[i], 0.1, times[i], start[i]), rtol=ROUNDING)


@pytest.mark.usefixtures("chunks")
def test_a_batch_of_batches_is_one_larger_batch():
    times, factor = jnp.arange(7), jnp.linspace(0.8, 1.2, 5)
    both = jax.vmap(jax.vmap(grow, in_axes=(None, None, 0, None)), in_axes=(0, None, None, 0))
    start = jnp.arange(10.0).reshape(5, 2)
    _, v = both(factor, 0.5, times, start)
    for i, j in np.ndindex(5, 7):
        np.testing.assert_allclose(v[i, j], by_hand(factor[i], 0.5, times[j], start[i]), rtol=ROUNDING)


@pytest.mark.usefixtures("chunks")
def test_an_element_that_has_ended_is_not_stepped_again():
    def step(_, state):
        return state[0] - 1, jnp.where(state[0] > 0, state[1], jnp.nan)  # a superfluous step gives NaN

    run = jax.vmap(lambda times: batching.while_loop(lambda s: s[0] > 0, step, None, (times, jnp.ones(()))))
    np.testing.assert_array_equal(run(jnp.array([0, 1, 17, 3]))[1], 1.0)


@pytest.mark.usefixtures("in_chunks")
def test_a_chunk_is_filled_up_with_elements_that_have_ended():
    stepped = []
    run = jax.vmap(lambda times: count_down(times, stepped))
    jax.block_until_ready(run(jnp.array([1] * (FULL - 3) + [3] * 3)))
    jax.effects_barrier()
    assert sorted(stepped) == [0] * 2 * (FULL - 3) + [1] * FULL + [2] * 3 + [3] * 3


def test_on_a_cpu_an_element_takes_its_own_steps_alone():
    stepped = []
    run = jax.vmap(lambda times: count_down(times, stepped, ordered=True))
    jax.block_until_ready(run(jnp.array([2, 0, 3])))
    jax.effects_barrier()
    assert stepped == [2, 1, 3, 2, 1]


@pytest.mark.parametrize("batched", [False, True])
@pytest.mark.usefixtures("chunks")
def test_what_is_not_needed_is_left_as_it_is(batched):
    act = lambda fixed, v, _: v + fixed  # noqa: E731
    one = lambda needed, v: batching.where_needed(needed, act, jnp.ones(()), v)  # noqa: E731
    needed, values = jnp.array([True, False, True]), jnp.array([1.0, 2.0, jnp.nan])
    if batched:
        np.testing.assert_array_equal(jax.vmap(one)(needed, values), [2.0, 2.0, np.nan])
    else:
        np.testing.assert_array_equal(
            [one(n, v) for n, v in zip(needed, values, strict=True)], [2.0, 2.0, np.nan]
        )


@pytest.mark.usefixtures("in_chunks")
def test_a_loop_inside_steps_what_is_needed_alone():
    stepped = []
    act = lambda _, times, needed: count_down(jnp.where(needed, times, 0), stepped)  # noqa: E731
    times = jnp.arange(1, FULL + 1)
    run = jax.vmap(lambda needed, times: batching.where_needed(needed, act, None, times))
    jax.block_until_ready(run(times > FULL - 2, times))
    jax.effects_barrier()
    assert sorted(v for v in stepped if v > 0) == sorted([*range(1, FULL + 1), *range(1, FULL)])


@pytest.mark.usefixtures("chunks")
def test_gradients_go_round_it():
    def end(x):
        frozen = jax.lax.stop_gradient(x)
        return x * grow(1.0, 0.0, jnp.asarray(3), frozen)[1]

    np.testing.assert_allclose(jax.vmap(jax.grad(end))(jnp.array([2.0, 5.0])), [2.0, 5.0])


@pytest.mark.usefixtures("chunks")
def test_batches_share_what_is_not_their_own():
    """Three batch axes: one array for each axis, and one array over two axes."""

    def one(a, b, c, times):
        step = lambda fixed, s: (s[0] - 1, fixed[0] * s[1] + fixed[1] * fixed[2])  # noqa: E731
        return batching.while_loop(lambda s: s[0] > 0, step, (a, b, c), (times, jnp.ones(())))[1]

    a, b, c = jnp.linspace(0.5, 0.9, 2), jnp.arange(3.0), jnp.arange(12.0).reshape(4, 3) + 1.0
    times = jnp.arange(6).reshape(2, 3)
    rows = jax.vmap(one, in_axes=(None, 0, 0, 0))  # b, c and times along their last axis
    planes = jax.vmap(rows, in_axes=(0, None, None, 0))  # a and times
    found = jax.vmap(planes, in_axes=(None, None, 0, None))(a, b, c, times)
    for k, i, j in np.ndindex(4, 2, 3):
        expected = by_hand(float(a[i]), float(b[j] * c[k, j]), times[i, j], 1.0)
        np.testing.assert_allclose(found[k, i, j], expected, rtol=ROUNDING)


ON_TWO_DEVICES = """
import jax, jax.numpy as jnp
from jax.sharding import AxisType, PartitionSpec as P
from jaxscp.core import batching

def count(times):
    return batching.while_loop(lambda s: s[0] > 0, lambda _, s: (s[0] - 1, 2 * s[1]), None, (times, jnp.ones((),
    int)))[1]

mesh = jax.make_mesh((2,), ("batch",), axis_types=(AxisType.Auto,))
spec = P("batch")
both = jax.jit(jax.shard_map(jax.vmap(count), mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False))
found = both(jnp.arange(20) % 7)
assert len(found.sharding.device_set) == 2
print(*found)
"""


def test_each_device_steps_its_own_elements():
    devices = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "-c", ON_TWO_DEVICES],
        env=os.environ | devices,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal([int(v) for v in done.stdout.split()], 2 ** (np.arange(20) % 7))


@pytest.mark.parametrize("shape", [(3,), (20,), (2, 9)], ids=str)
@pytest.mark.usefixtures("chunks")
def test_chunks_have_the_results_of_the_whole_batch(shape):
    """Also with an argument that the batch elements share, in two nested batches, and without a batch."""
    own = jax.random.normal(jax.random.key(0), (*shape, 4))
    shared = jnp.arange(4.0)
    act = lambda fixed: {"dot": jnp.vdot(*fixed), "sum": fixed[0] + fixed[1]}  # noqa: E731
    chunked, plain = lambda v: batching.in_chunks(act, (v, shared)), lambda v: act((v, shared))
    for _ in shape:
        chunked, plain = jax.vmap(chunked), jax.vmap(plain)
    jax.tree.map(np.testing.assert_allclose, jax.jit(chunked)(own), plain(own))
    alone = own[(0,) * len(shape)]
    jax.tree.map(
        np.testing.assert_array_equal, batching.in_chunks(act, (alone, shared)), act((alone, shared))
    )


@pytest.mark.usefixtures("chunks")
def test_a_batch_of_no_elements():
    """Alone, in chunks, and inside another batch."""

    def halvings(v):
        return batching.while_loop(lambda s: s > 1.0, lambda _, s: 0.5 * s, (), v)

    assert jax.vmap(halvings)(jnp.zeros(0)).shape == (0,)
    assert jax.vmap(lambda v: batching.in_chunks(jnp.sum, v))(jnp.zeros((0, 4))).shape == (0,)
    assert jax.vmap(jax.vmap(halvings))(jnp.zeros((0, 3))).shape == (0, 3)
    assert jax.vmap(jax.vmap(halvings))(jnp.zeros((3, 0))).shape == (3, 0)
    assert jax.vmap(jax.vmap(halvings))(jnp.full((2, 3), 5.0)).tolist() == [[0.625] * 3] * 2
