"""The right-hand side of intervals as tapes."""

from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array

from jaxscp.backends.codegen.functions import TapedFunction, record
from jaxscp.integration.intervals import Intervals


def record_rate(intervals: Intervals, inputs: int, order: int) -> TapedFunction:
    """Tapes of the rate, a function of the state and the controls, side by side.

    Args:
        intervals: the integration.
        inputs: size of w.
        order: highest derivative.

    Raises:
        CannotTrace: if the rate is not arithmetic alone.
    """
    rate = _Rate(intervals.rate, intervals.states)
    return record(rate, intervals.states + intervals.controls(inputs), (), order)


class _Rate(eqx.Module):
    rate: Callable[..., Array]
    states: int = eqx.field(static=True)

    def __call__(self, a: Array) -> Array:
        return self.rate(a[: self.states], a[self.states :])
