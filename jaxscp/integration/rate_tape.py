"""The rate of intervals as tapes."""

from jaxscp.backends.codegen.functions import Function, record
from jaxscp.integration.intervals import Intervals


def record_slopes(intervals: Intervals, inputs: int, order: int) -> Function:
    """The rate of intervals of so many inputs, as a function of a state and its controls.

    Raises:
        CannotTrace: if it is not arithmetic alone.
    """
    n = intervals.states
    return record(lambda a: intervals.rate(a[:n], a[n:]), n + intervals.controls(inputs), (), order)
