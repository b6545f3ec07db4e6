"""Integration in JAX, which evaluates the rate's tape; for GPUs without a kernel.

Every number is an array over the intervals, every tangent an array over inputs and intervals. XLA fuses these
operations into a few kernels a step. JAX's derivatives of the rate would be hundreds of small, mostly zero arrays.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends.codegen.evaluate_tape import evaluate
from jaxscp.backends.codegen.functions import TapedFunction
from jaxscp.integration.intervals import IntervalOutputs, Intervals
from jaxscp.integration.rate_tape import record_rate

Rows = Sequence[Array]


def linearise(
    intervals: Intervals, w: Float[Array, "intervals inputs"]
) -> tuple[IntervalOutputs, IntervalOutputs]:
    """Outputs and Jacobians of intervals without path outputs.

    Raises:
        CannotTrace: if the rate is not arithmetic alone.
    """
    n, inputs, method = intervals.states, w.shape[1], intervals.method
    size = 1.0 / intervals.steps
    columns, directions = w.T, jnp.eye(inputs, dtype=w.dtype)[:, :, None]
    rate = _Rate(intervals, columns, directions)

    def forward(step, carry):
        state, tangent = carry
        slopes, slope_tangents = [], []
        for c, row in zip(method.c.tolist(), method.a.tolist(), strict=True):
            fraction = size * (jnp.asarray(step, w.dtype) + c)
            stage_state = _advance(state, size, row, slopes)
            slope, slope_tangent = rate(fraction, stage_state, _advance(tangent, size, row, slope_tangents))
            slopes.append(slope)
            slope_tangents.append(slope_tangent)
        b = method.b.tolist()
        return _advance(state, size, b, slopes), _advance(tangent, size, b, slope_tangents)

    zeros = jnp.zeros((inputs, w.shape[0]), w.dtype)
    start = [*columns[:n], jnp.zeros_like(columns[0])], [zeros + directions[r] for r in range(n)] + [zeros]
    path, tangents = jax.lax.fori_loop(0, intervals.steps, forward, start)
    # without the barrier, XLA stacks the rows again in every kernel that reads the result
    end, jacobian = jax.lax.optimization_barrier(
        (jnp.stack(path, -1), jnp.transpose(jnp.stack(tangents), (2, 0, 1)))
    )
    none, count = (), w.shape[0]
    return (
        IntervalOutputs(end[:, :n], end[:, n], none, jnp.zeros((count, 0))),
        IntervalOutputs(jacobian[:, :n], jacobian[:, n], none, jnp.zeros((count, 0, inputs))),
    )


class _Rate:
    """The rate and its tangents, by rows."""

    def __init__(self, intervals: Intervals, columns: Array, directions: Array) -> None:
        self.n, self.m = intervals.states, intervals.controls(columns.shape[0])
        self.columns, self.directions = columns, directions
        self.tapes: TapedFunction = record_rate(intervals, columns.shape[0], order=1)

    def __call__(self, fraction: Array, state: Rows, tangent: Rows) -> tuple[Rows, Rows]:
        """Slopes at a fraction of the interval, and their tangents."""
        n, m, columns, directions = self.n, self.m, self.columns, self.directions
        controls = [columns[n + k] + fraction * (columns[n + m + k] - columns[n + k]) for k in range(m)]
        control_tangents = [
            (1.0 - fraction) * directions[n + k] + fraction * directions[n + m + k] for k in range(m)
        ]
        no_multipliers = [jnp.zeros_like(columns[0])] * (n + 1)
        inputs = [*state[:n], *controls, *no_multipliers]
        outputs = evaluate(self.tapes.first, inputs, self.tapes.parameters[0])
        argument_tangents = [*tangent[:n], *control_tangents]
        slope_tangents = [jnp.zeros_like(row) for row in tangent]
        for (r, k), entry in zip(self.tapes.jacobian.tolist(), outputs[n + 1 :], strict=True):
            slope_tangents[r] = slope_tangents[r] + entry * argument_tangents[k]
        return outputs[: n + 1], slope_tangents


def _advance(rows: Rows, size: float, weights: Sequence[float], slopes: Sequence[Rows]) -> Rows:
    """x + h sum_j weights_j k_j, row by row."""
    found = []
    for r, row in enumerate(rows):
        for weight, slope in zip(weights, slopes, strict=False):
            row = row + (size * weight) * slope[r] if weight else row
        found.append(row)
    return found
