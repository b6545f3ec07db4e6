"""How accurately a flight is flown, whoever flies it."""

TOLERANCE = 1e-10  # of a step's error, relative and absolute
FIRST_STEP = 0.25  # of an interval, that is tried
MAX_STEPS, LEAST_STEPS = 2048, 64  # of a flight; of an interval its share, or so many


def most_steps(intervals: int) -> int:
    """Steps that an interval may take; memory is set aside for them."""
    return max(MAX_STEPS // intervals, LEAST_STEPS)
