"""The pass in JAX by a tape: every number is an array over the intervals, every tangent one over the inputs too.

What is elementwise a compiler fuses: of a step it makes a few kernels, where derivatives of the rate by JAX are
hundreds of operations on small arrays, most of whose entries are zero. This is the way of GPUs for which there is no
kernel.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends.codegen.evaluate_tape import play
from jaxscp.integration.intervals import IntervalOutputs, Intervals
from jaxscp.integration.rate_tape import record_slopes


def linear(
    intervals: Intervals, w: Float[Array, "intervals inputs"]
) -> tuple[IntervalOutputs, IntervalOutputs]:
    """Outcomes and Jacobians of intervals whose points nothing is asked of.

    Raises:
        CannotTrace: if the slopes are not arithmetic alone.
    """
    n, inputs = intervals.states, w.shape[1]
    m, size = intervals.controls(inputs), 1.0 / intervals.steps
    slopes = record_slopes(intervals, inputs, order=1)
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
        pulled = [(1.0 - share) * directions[n + k] + share * directions[n + m + k] for k in range(m)]
        free_of_charge = [jnp.zeros_like(columns[0])] * (n + 1)
        outputs = play(slopes.first, [*state[:n], *controls, *free_of_charge], slopes.parameters[0])
        moved = [*tangent[:n], *pulled]
        pushed = [jnp.zeros_like(row) for row in tangent]
        for (r, k), entry in zip(slopes.jacobian.tolist(), outputs[n + 1 :], strict=True):
            pushed[r] = pushed[r] + entry * moved[k]
        return outputs[: n + 1], pushed

    def forward(step, carry):
        state, tangent = carry
        ways, pushed = [], []
        for share, weights in zip(method.shares.tolist(), method.table.tolist(), strict=True):
            at = size * (jnp.asarray(step, w.dtype) + share)
            found = stage(at, after(state, weights, ways), after(tangent, weights, pushed))
            ways.append(found[0])
            pushed.append(found[1])
        weights = method.weights.tolist()
        return after(state, weights, ways), after(tangent, weights, pushed)

    like = jnp.zeros((inputs, w.shape[0]), w.dtype)
    start = [*columns[:n], jnp.zeros_like(columns[0])], [like + directions[r] for r in range(n)] + [like]
    path, tangents = jax.lax.fori_loop(0, intervals.steps, forward, start)
    # what reads of it is not to put it together from its rows anew
    end, jacobian = jax.lax.optimization_barrier(
        (jnp.stack(path, -1), jnp.transpose(jnp.stack(tangents), (2, 0, 1)))
    )
    none, count = (), w.shape[0]
    return (
        IntervalOutputs(end[:, :n], end[:, n], none, jnp.zeros((count, 0))),
        IntervalOutputs(jacobian[:, :n], jacobian[:, n], none, jnp.zeros((count, 0, inputs))),
    )
