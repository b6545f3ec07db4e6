"""The right-hand side of intervals as tapes."""

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
    n = intervals.states
    return record(lambda a: intervals.rate(a[:n], a[n:]), n + intervals.controls(inputs), (), order)
