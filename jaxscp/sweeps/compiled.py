"""The pass in C++, for float64 on a CPU: the slopes and their derivatives by a tape, the rest as written there.

XLA runs the tangents of a Runge-Kutta step as hundreds of small operations on arrays that are mostly zero. Here the
zeros are known before, and sixteen intervals go through each operation in a register.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.sweeps import native
from jaxscp.sweeps.intervals import Intervals, Pass
from jaxscp.sweeps.slopes import Slopes


def serves(w: Array) -> bool:
    """Whether it goes through intervals of these variables."""
    return w.dtype == jnp.float64 and native.available()


def first_inputs(jacobian: np.ndarray, states: int, inputs: int) -> np.ndarray:
    """By row of the path, the first of an interval's inputs that it can depend on; all after it count as such."""
    first = np.array([*range(states), inputs])
    for _ in range(states + 1):
        for row, column in jacobian:
            first[row] = min(first[row], first[column] if column < states else column)
    return first.astype(np.int32)


def sweep(
    intervals: Intervals, slopes: Slopes, w: Float[Array, "intervals inputs"], prices: Array | None
) -> Pass:
    """The pass, with operations already found."""
    n, inputs, priced = intervals.states, w.shape[-1], prices is not None
    kept = intervals.steps // intervals.every
    shapes = [(kept, n + 1), (kept, n + 1, inputs), (inputs, inputs)][: 2 + priced]
    results = [jax.ShapeDtypeStruct((w.shape[0], *shape), w.dtype) for shape in shapes]
    recorded, method = slopes.tape, intervals.method
    numbers = {
        "states": n,
        "controls": intervals.controls(inputs),
        "steps": intervals.steps,
        "every": intervals.every,
        "priced": priced,
        "once": recorded.once,
        "places": recorded.places,
        "parameters": slopes.parameters.size,
    }
    tables = {
        "shares": method.shares,
        "weights": method.weights,
        "table": method.table.ravel(),
        "operations": recorded.operations.ravel(),
        "constants": recorded.constants,
        "outputs": recorded.outputs,
        "jacobian": slopes.jacobian.ravel(),
        "hessian": slopes.hessian.ravel(),
        "first": first_inputs(slopes.jacobian, n, inputs),
    }
    arrays = [w, slopes.parameters] + [prices] * priced
    path, tangent, *curvature = jax.ffi.ffi_call(native.TARGET, results, vmap_method="broadcast_all")(
        *arrays, **{name: np.int64(v) for name, v in numbers.items()}, **tables
    )
    return Pass(path, tangent, curvature[0] if priced else None)
