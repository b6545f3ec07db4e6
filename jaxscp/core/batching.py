"""Loops over a batch whose elements end at different times.

``jax.vmap`` of ``jax.lax.while_loop`` steps every element until the last one ends. Of thousands of plans most need six
subproblems and a few need sixty, so that nine tenths of the work is wasted. Here a batch is stepped in rounds: the
unfinished elements are gathered, stepped a chunk at a time, and scattered back. The result of an element is the same.
Finished elements fill up the last chunk of a round; a step that notices this can save their work.

On a CPU each element runs alone, from its first step to its last: a batch there saves no arithmetic, and the program of
one element is smaller.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from jaxscp.core.types import Flag

State = TypeVar("State")

# Chunk sizes: the usual one, and optionally a second, smaller one for the last unfinished elements.
Chunks = tuple[int, ...]

# Elements stepped at once. A small chunk wastes little work on finished elements; it must still be large enough to
# use the whole device. ``ALONE``: no chunks, an element after the other.
ALONE: Chunks = (1,)
CHUNK: dict[str, Chunks] = {"cpu": ALONE}
CHUNK_ELSEWHERE: Chunks = (2048,)
# For long loops: after most elements have ended, a step of the few others must not take as long as one of all.
CHUNK_OF_LONG_LOOPS: Chunks = 512, 64
# For subproblems: the kernel that solves a chunk has as many blocks as fit on the GPU, and a block that ends a program
# takes the next one. So a large chunk waits for few slow programs.
CHUNK_OF_SUBPROBLEMS: Chunks = 4096, 512
# For loops around long loops: each chunk waits for its slowest element, so chunks are few.
CHUNK_AROUND_LOOPS: Chunks = (4096,)
FEW = 2  # small chunks that take no longer than a large one with as many unfinished elements


def while_loop(
    unfinished: Callable[[State], Flag],
    step: Callable[[Any, State], State],
    fixed: Any,
    state: State,
    elsewhere: Chunks = CHUNK_ELSEWHERE,
) -> State:
    """``jax.lax.while_loop``; under ``vmap``, in rounds over the unfinished elements.

    The loop has no derivative: apply ``jax.lax.stop_gradient`` to ``fixed`` and ``state`` first.

    Args:
        unfinished: whether a state needs another step.
        step: from ``fixed`` and a state to the next; closes over no array.
        fixed: any pytree, constant over the loop.
        state: a pytree of arrays, to begin with.
        elsewhere: elements stepped at once on devices other than CPUs. A second, smaller number serves the last
            unfinished elements; the step is then compiled for both.
    """
    arrays, rest = eqx.partition(fixed, eqx.is_array)
    traced_step = jax.jit(  # traced once for all uses below
        lambda arrays, state: step(eqx.combine(arrays, rest), state)
    )

    @custom_vmap
    def loop(arrays, state):
        return jax.lax.while_loop(unfinished, lambda s: traced_step(arrays, s), state)

    @loop.def_vmap
    def _(size, batched, arrays, state):
        arrays_batched, state_batched = batched
        states = jax.tree.map(lambda v, b: v if b else _repeat(v, size), state, state_batched)
        shared = jax.tree.map(int, arrays_batched)
        batch = _BatchLoop(unfinished, traced_step, size, elsewhere)
        return _all_batched(_batch_loop(batch, shared)(arrays, states))

    return loop(arrays, state)


def where_needed(
    needed: Flag,
    act: Callable[[Any, State, Flag], State],
    fixed: Any,
    state: State,
    elsewhere: Chunks = CHUNK_ELSEWHERE,
) -> State:
    """What ``act`` returns where needed, else the state; under ``vmap`` the other elements cost nothing.

    Args:
        needed: whether it is.
        act: from ``fixed``, the state and ``needed`` to the next state. ``needed`` is false for the elements that fill
            up a chunk: their result is dropped, and loops inside of ``act`` should not step them.
        fixed: any pytree.
        state: a pytree of arrays.
        elsewhere: elements of a chunk on devices other than CPUs, as above.
    """
    end, _ = while_loop(
        lambda s: s[1],
        lambda fixed, s: (act(fixed, *s), jnp.zeros_like(s[1])),
        fixed,
        (state, needed),
        elsewhere,
    )
    return end


def in_chunks(act: Callable[[Any], State], fixed: Any, elsewhere: Chunks = CHUNK_ELSEWHERE) -> State:
    """``act(fixed)``; under ``vmap``, a chunk of elements at a time, so that memory is needed for one chunk only.

    The result has no derivative: apply ``jax.lax.stop_gradient`` to ``fixed`` first.

    Args:
        act: function of one element.
        fixed: any pytree.
        elsewhere: elements of a chunk on devices other than CPUs, as above.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from jaxscp.core.batching import in_chunks
        >>> jax.vmap(lambda v: in_chunks(jnp.sum, v))(jnp.ones((3, 5))).tolist()
        [5.0, 5.0, 5.0]
    """
    arrays, rest = eqx.partition(fixed, eqx.is_array)
    on_arrays = jax.jit(lambda arrays: act(eqx.combine(arrays, rest)))  # traced once for all uses below

    @custom_vmap
    def one(arrays):
        return on_arrays(arrays)

    @one.def_vmap
    def _(size, batched, arrays):
        shape_of = lambda v, b: jax.ShapeDtypeStruct(v.shape[1:] if b else v.shape, v.dtype)  # noqa: E731
        first = jax.tree.map(shape_of, arrays, batched[0])
        blank = jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), jax.eval_shape(on_arrays, first))
        axes = jax.tree.map(lambda b: 0 if b else None, batched[0])
        chunked = lambda arrays: where_needed(  # noqa: E731
            jnp.ones((), bool), lambda arrays, *_: on_arrays(arrays), arrays, blank, elsewhere
        )
        return _all_batched(jax.vmap(chunked, in_axes=(axes,), axis_size=size)(arrays))

    return one(arrays)


def alone_on_a_cpu(act: Callable[[Any], State], fixed: Any) -> State:
    """``act(fixed)``; under ``vmap`` on a CPU, an element after the other; elsewhere the batch that ``vmap`` makes.

    The result has no derivative: apply ``jax.lax.stop_gradient`` to ``fixed`` first.

    Args:
        act: function of one element; it loops by this file's functions.
        fixed: any pytree.
    """
    return in_chunks(act, fixed) if CHUNK.get(jax.default_backend()) == ALONE else act(fixed)


class _BatchLoop(eqx.Module):
    """The loop of a batch."""

    unfinished: Callable[..., Any] = eqx.field(static=True)
    """Of one element's state."""
    step: Callable[..., Any] = eqx.field(static=True)
    """Of one element."""
    size: int = eqx.field(static=True)
    """Elements."""
    elsewhere: Chunks = eqx.field(static=True)

    def resized(self, size: int) -> "_BatchLoop":
        """The loop of a batch of another size."""
        return _BatchLoop(self.unfinished, self.step, size, self.elsewhere)


def _batch_loop(loop_of: _BatchLoop, shared):
    """The loop for a batch. Under another ``vmap``, the loop of one larger batch.

    Args:
        loop_of: the loop.
        shared: for each constant array, how many consecutive elements use one entry of its leading axis, which is
            cycled through; zero if all elements use the whole array.
    """
    size = loop_of.size

    @custom_vmap
    def loop(arrays, states):
        return _in_rounds(loop_of, shared, arrays, states)

    @loop.def_vmap
    def _(batches, batched, arrays, states):
        merge = lambda v: v.reshape(batches * v.shape[1], *v.shape[2:])  # noqa: E731
        split = lambda v: v.reshape(batches, size, *v.shape[1:])  # noqa: E731
        if batches * size == 0:
            return _all_batched(
                jax.tree.map(lambda v, b: v if b else _repeat(v, batches), states, batched[1])
            )

        def merged(v, outer, inner):
            if not outer:
                return v, inner
            if not inner:
                return v, size
            times = size // (inner * v.shape[1])  # cycles of the inner batch through the array
            return merge(jnp.tile(v, (1, times) + (1,) * (v.ndim - 2))), inner

        pairs = jax.tree.map(merged, arrays, batched[0], shared)
        arrays, outer_shared = (jax.tree.map(lambda _, p, k=k: p[k], arrays, pairs) for k in range(2))
        states = jax.tree.map(lambda v, outer: merge(v if outer else _repeat(v, batches)), states, batched[1])
        whole = _batch_loop(loop_of.resized(batches * size), outer_shared)
        return _all_batched(jax.tree.map(split, whole(arrays, states)))

    return loop


def _repeat(v, times: int):
    return jnp.broadcast_to(v, (times, *jnp.shape(v)))


def _all_batched(end):
    """The result, and for ``custom_vmap`` the statement that every leaf is batched."""
    return end, jax.tree.map(lambda _: True, end)


def _entries(v, index, repeats: int):
    """What batch elements use of a constant array; see ``shared`` above."""
    return v[(index // repeats) % v.shape[0]] if repeats else v


def _one_by_one(loop_of: _BatchLoop, shared, arrays, states):
    """Each element's own loop, one after the other."""

    def one(element):
        index, state = element
        fixed = jax.tree.map(lambda v, k: _entries(v, index, k), arrays, shared)
        return jax.lax.while_loop(loop_of.unfinished, lambda s: loop_of.step(fixed, s), state)

    return jax.lax.map(one, (jnp.arange(loop_of.size), states))


def _in_rounds(loop_of: _BatchLoop, shared, arrays, states):
    """Step the unfinished elements, chunk by chunk, until there are none."""
    size, unfinished = loop_of.size, loop_of.unfinished
    chunks_here = CHUNK.get(jax.default_backend(), loop_of.elsewhere)
    if size == 0:
        return states
    if chunks_here == ALONE:
        return _one_by_one(loop_of, shared, arrays, states)
    chunk, *few = (min(size, count) for count in chunks_here)
    small = few[0] if few else chunk
    axes = jax.tree.map(lambda k: 0 if k else None, shared)

    def one_chunk(order, end, first, length, states):
        index = jax.lax.dynamic_slice(order, (first,), (length,))
        fixed = jax.tree.map(lambda v, k: _entries(v, index, k), arrays, shared)
        new = jax.vmap(loop_of.step, in_axes=(axes, 0))(fixed, jax.tree.map(lambda v: v[index], states))
        continues = first + jnp.arange(length) < end
        to = jnp.where(continues, index, size)  # out of bounds: never written
        return jax.tree.map(lambda v, part: v.at[to].set(part, mode="drop"), states, new)

    def chunks(order, first, end, length, states):
        """Chunks of one length, from the first to the end in an order."""
        count = (end - first + length - 1) // length
        return jax.lax.fori_loop(
            0, count, lambda i, s: one_chunk(order, end, first + i * length, length, s), states
        )

    def one_round(states):
        active = jax.vmap(unfinished)(states)
        # finished elements come after the unfinished ones
        order = jnp.pad(jnp.argsort(~active, stable=True), (0, -size % chunk + small), mode="edge")
        count = jnp.sum(active)
        if small == chunk:
            return chunks(order, 0, count, chunk, states)
        rest = count % chunk
        large = jnp.where(rest <= FEW * small, count - rest, count)
        return chunks(order, large, count, small, chunks(order, 0, large, chunk, states))

    return jax.lax.while_loop(lambda s: jnp.any(jax.vmap(unfinished)(s)), one_round, states)
