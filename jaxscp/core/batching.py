"""Loops over a batch whose lanes end at different times.

``jax.vmap`` of ``jax.lax.while_loop`` steps every lane until the last one ends. Of thousands of plans most need six
subproblems and a few need sixty, so that nine tenths of that work is thrown away. Here a batch is stepped in rounds:
the lanes that have not ended are gathered, stepped a tile at a time, and put back. What a lane computes is the same.
A tile that they do not fill has lanes that have ended too: to step those costs least if the step sees that.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from jaxscp.core.types import Flag

State = TypeVar("State")

# Sizes: the usual one and, if another follows, that of tiles for the few lanes that are left.
Tiles = tuple[int, ...]

# Lanes stepped at once: few, so that little work is wasted on those that have ended in a tile; but enough for the
# device, which a smaller tile keeps busy no less long.
TILE: dict[str, Tiles] = {"cpu": (8,)}
TILE_ELSEWHERE: Tiles = (2048,)
FEW = 2  # small tiles that take no longer than a large one of which as many lanes go on


def while_loop(
    unfinished: Callable[[State], Flag],
    step: Callable[[Any, State], State],
    fixed: Any,
    state: State,
    elsewhere: Tiles = TILE_ELSEWHERE,
) -> State:
    """``jax.lax.while_loop``; under ``vmap``, in rounds over the lanes that are not finished.

    It has no derivative: keep those of ``fixed`` and ``state`` away by ``jax.lax.stop_gradient``.

    Args:
        unfinished: whether a state is to be stepped.
        step: from ``fixed`` and a state to the next; closes over no array.
        fixed: any pytree that stays as it is.
        state: a pytree of arrays, to begin with.
        elsewhere: lanes stepped at once on other devices than CPUs. A second, smaller number is of the few that are
            left: what steps them is then compiled for both.
    """
    arrays, rest = eqx.partition(fixed, eqx.is_array)
    traced_step = jax.jit(
        lambda arrays, state: step(eqx.combine(arrays, rest), state)
    )  # traced once for all uses below

    @custom_vmap
    def loop(arrays, state):
        return jax.lax.while_loop(unfinished, lambda s: traced_step(arrays, s), state)

    @loop.def_vmap
    def _(lanes, batched, arrays, state):
        own, begun = batched
        states = jax.tree.map(lambda v, b: v if b else _repeat(v, lanes), state, begun)
        every = jax.tree.map(int, own)
        return _all(_many(unfinished, traced_step, lanes, elsewhere, every)(arrays, states))

    return loop(arrays, state)


def where_needed(
    needed: Flag,
    act: Callable[[Any, State], State],
    fixed: Any,
    state: State,
    elsewhere: Tiles = TILE_ELSEWHERE,
) -> State:
    """``act(fixed, state)`` where that is needed, else the state; under ``vmap`` the other lanes cost nothing."""
    end, _ = while_loop(
        lambda s: s[1],
        lambda fixed, s: (act(fixed, s[0]), jnp.zeros_like(s[1])),
        fixed,
        (state, needed),
        elsewhere,
    )
    return end


def in_tiles(act: Callable[[Any], State], fixed: Any, elsewhere: Tiles = TILE_ELSEWHERE) -> State:
    """``act(fixed)``; under ``vmap``, a tile of lanes at a time, so that what it holds meanwhile is held for a tile.

    It has no derivative: keep those of ``fixed`` away by ``jax.lax.stop_gradient``.

    Args:
        act: what is done with a lane.
        fixed: any pytree.
        elsewhere: lanes of a tile on other devices than CPUs, as above.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from jaxscp.core.batching import in_tiles
        >>> jax.vmap(lambda v: in_tiles(jnp.sum, v))(jnp.ones((3, 5))).tolist()
        [5.0, 5.0, 5.0]
    """
    arrays, rest = eqx.partition(fixed, eqx.is_array)
    traced_step = lambda arrays: act(eqx.combine(arrays, rest))  # noqa: E731

    @custom_vmap
    def one(arrays):
        return traced_step(arrays)

    @one.def_vmap
    def _(lanes, batched, arrays):
        blank = jax.tree.map(
            lambda v: jnp.zeros(v.shape, v.dtype), jax.eval_shape(traced_step, lane_of(batched, arrays))
        )
        axes = jax.tree.map(lambda b: 0 if b else None, batched[0])
        tiled = lambda arrays: where_needed(  # noqa: E731
            jnp.ones((), bool), lambda arrays, _: traced_step(arrays), arrays, blank, elsewhere
        )
        return _all(jax.vmap(tiled, in_axes=(axes,), axis_size=lanes)(arrays))

    def lane_of(batched, arrays):
        return jax.tree.map(lambda v, b: v[0] if b else v, arrays, batched[0])

    return one(arrays)


def _many(unfinished, step, lanes: int, elsewhere: Tiles, every):
    """The loop for a batch. Under another ``vmap``, that of one larger batch.

    Args:
        unfinished: of one lane's state.
        step: of one lane.
        lanes: how many.
        elsewhere: how many of them at once on other devices than CPUs, as above.
        every: of each of the arrays that stay, how many lanes in a row share an entry of its leading axis, which is run
            through again when it ends; zero where all share the array.
    """

    @custom_vmap
    def loop(arrays, states):
        return _in_rounds(unfinished, step, lanes, elsewhere, every, arrays, states)

    @loop.def_vmap
    def _(batches, batched, arrays, states):
        merge = lambda v: v.reshape(batches * v.shape[1], *v.shape[2:])  # noqa: E731
        split = lambda v: v.reshape(batches, lanes, *v.shape[1:])  # noqa: E731

        def merged(v, outer, inner):
            if not outer:
                return v, inner
            if not inner:
                return v, lanes
            times = lanes // (inner * v.shape[1])  # that the inner batch runs through it
            return merge(jnp.tile(v, (1, times) + (1,) * (v.ndim - 2))), inner

        pairs = jax.tree.map(merged, arrays, batched[0], every)
        arrays, shared = (jax.tree.map(lambda _, p, k=k: p[k], arrays, pairs) for k in range(2))
        states = jax.tree.map(lambda v, outer: merge(v if outer else _repeat(v, batches)), states, batched[1])
        return _all(
            jax.tree.map(split, _many(unfinished, step, batches * lanes, elsewhere, shared)(arrays, states))
        )

    return loop


def _repeat(v, times: int):
    return jnp.broadcast_to(v, (times, *jnp.shape(v)))


def _all(end):
    """With what ``custom_vmap`` asks for: every leaf is batched."""
    return end, jax.tree.map(lambda _: True, end)


def _in_rounds(unfinished, step, lanes: int, elsewhere: Tiles, every, arrays, states):
    """Step the lanes that are not finished, tile by tile, until there are none."""
    tile, *few = (min(lanes, size) for size in TILE.get(jax.default_backend(), elsewhere))
    small = few[0] if few else tile
    axes = jax.tree.map(lambda k: 0 if k else None, every)

    def one_tile(order, end, first, size, states):
        index = jax.lax.dynamic_slice(order, (first,), (size,))
        entries = lambda v, k: v[(index // k) % v.shape[0]] if k else v  # noqa: E731
        fixed = jax.tree.map(entries, arrays, every)
        new = jax.vmap(step, in_axes=(axes, 0))(fixed, jax.tree.map(lambda v: entries(v, 1), states))
        goes_on = first + jnp.arange(size) < end
        to = jnp.where(goes_on, index, lanes)  # out of bounds: never written
        return jax.tree.map(lambda v, part: v.at[to].set(part, mode="drop"), states, new)

    def tiles(order, first, end, size, states):
        """Those of a size from the first to the end in an order."""
        count = (end - first + size - 1) // size
        return jax.lax.fori_loop(
            0, count, lambda i, s: one_tile(order, end, first + i * size, size, s), states
        )

    def one_round(states):
        going = jax.vmap(unfinished)(states)
        # behind those that go on are those that have ended
        order = jnp.pad(jnp.argsort(~going, stable=True), (0, -lanes % tile + small), mode="edge")
        count = jnp.sum(going)
        if small == tile:
            return tiles(order, 0, count, tile, states)
        rest = count % tile
        large = jnp.where(rest <= FEW * small, count - rest, count)
        return tiles(order, large, count, small, tiles(order, 0, large, tile, states))

    return jax.lax.while_loop(lambda s: jnp.any(jax.vmap(unfinished)(s)), one_round, states)
