"""The pass in JAX by a tape: every number is an array over the intervals, every tangent one over the inputs too.

What is elementwise a compiler fuses: of a step it makes a few kernels, where derivatives of the rate by JAX are
hundreds of operations on small arrays, most of whose entries are zero. This is the way of GPUs.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.sweeps import tape
from jaxscp.sweeps.slopes import Slopes

_OPERATIONS: dict[str, Callable[..., Array]] = {
    "sum": jnp.add,
    "difference": jnp.subtract,
    "product": jnp.multiply,
    "reciprocal": lambda a: 1.0 / a,
    "negative": jnp.negative,
    "choice": lambda which, yes, no: jnp.where(which != 0.0, yes, no),
    "multiply_add": lambda a, b, c: a * b + c,
    "multiply_subtract": lambda a, b, c: c - a * b,
    "max": jnp.maximum,
    "min": jnp.minimum,
    "abs": jnp.abs,
    **{name: getattr(jnp, name) for name in ("sqrt", "sin", "cos", "exp", "log", "tanh")},
    **{
        name: lambda a, b, compare=compare: compare(a, b).astype(a.dtype)
        for name, compare in {
            "lt": jnp.less,
            "le": jnp.less_equal,
            "gt": jnp.greater,
            "ge": jnp.greater_equal,
            "eq": jnp.equal,
        }.items()
    },
}
_OPERANDS = {
    "sqrt": 1,
    "sin": 1,
    "cos": 1,
    "exp": 1,
    "log": 1,
    "tanh": 1,
    "abs": 1,
    "reciprocal": 1,
    "negative": 1,
}
_OPERANDS |= {"choice": 3, "multiply_add": 3, "multiply_subtract": 3}


def play(recorded: tape.Tape, arguments: list[Array], parameters: Float[Array, "parameters"]) -> list[Array]:
    """The outputs of a tape."""
    names = list(tape.CODES)
    places: dict[int, Array] = dict(enumerate([*arguments, *parameters, *recorded.constants.tolist()]))
    for code, to, *operands in recorded.operations.tolist():
        name = names[code]
        places[to] = _OPERATIONS[name](*(places[v] for v in operands[: _OPERANDS.get(name, 2)]))
    return [places[v] for v in recorded.outputs.tolist()]


def sweep(intervals: Any, slopes: Slopes, w: Float[Array, "intervals inputs"]) -> tuple[Array, Array, None]:
    """The fields of a ``Pass`` without prices, with operations already found."""
    n, inputs = intervals.states, w.shape[1]
    m, size = (inputs - n) // 2, 1.0 / intervals.steps
    method = intervals.method
    columns = w.T
    directions = jnp.eye(inputs, dtype=w.dtype)[:, :, None]

    def after(rows, weights, ways):
        """Rows after slopes of these weights."""
        found = []
        for r, row in enumerate(rows):
            for weight, way in zip(weights, ways, strict=False):
                row = row + (size * weight) * way[r] if weight else row
            found.append(row)
        return found

    def stage(share, state, tangent):
        """Slopes, and their tangents."""
        controls = [columns[n + k] + share * (columns[n + m + k] - columns[n + k]) for k in range(m)]
        moved = [(1.0 - share) * directions[n + k] + share * directions[n + m + k] for k in range(m)]
        outputs = play(slopes.tape, [*state[:n], *controls], slopes.parameters)
        moved = [*tangent[:n], *moved]
        pushed = [jnp.zeros_like(row) for row in tangent]
        for (r, k), entry in zip(slopes.jacobian.tolist(), outputs[n + 1 :], strict=True):
            pushed[r] = pushed[r] + entry * moved[k]
        return outputs[: n + 1], pushed

    def forward(step, carry):
        state, tangent = carry
        ways, pushed = [], []
        for share, weights in zip(method.shares.tolist(), method.table.tolist(), strict=True):
            at = size * (step.astype(w.dtype) + share)
            found = stage(at, after(state, weights, ways), after(tangent, weights, pushed))
            ways.append(found[0])
            pushed.append(found[1])
        weights = method.weights.tolist()
        return after(state, weights, ways), after(tangent, weights, pushed)

    def to_next_kept(carry, begin):
        carry = jax.lax.fori_loop(begin, begin + intervals.every, forward, carry)
        return carry, carry

    like = jnp.zeros((inputs, w.shape[0]), w.dtype)
    start = [*columns[:n], jnp.zeros_like(columns[0])], [like + directions[r] for r in range(n)] + [like]
    begins = jnp.arange(0, intervals.steps, intervals.every)
    _, (path, tangents) = jax.lax.scan(to_next_kept, start, begins)
    found = jnp.moveaxis(jnp.stack(path, -1), 1, 0), jnp.transpose(jnp.stack(tangents, -1), (2, 0, 3, 1))
    # what reads of them is not to put them together from their rows anew
    return (*jax.lax.optimization_barrier(found), None)
