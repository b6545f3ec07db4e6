"""Accuracy of the verifier's integration, on every device."""

TOLERANCE = 1e-10  # error of a step, relative and absolute
FIRST_STEP = 0.25  # of an interval: the first trial
MAX_STEPS, LEAST_STEPS = 2048, 64  # of a trajectory; at least of an interval


def most_steps(intervals: int) -> int:
    """Steps that an interval may take; memory is reserved for them."""
    return max(MAX_STEPS // intervals, LEAST_STEPS)
