"""Confidence intervals of shares and means."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

CONFIDENCE = 0.95


class Interval(NamedTuple):
    """An estimate and its confidence interval."""

    estimate: float
    lower: float
    upper: float

    @property
    def width(self) -> float:
        """Upper limit less lower limit."""
        return self.upper - self.lower


def wilson(successes: int, count: int, confidence: float = CONFIDENCE) -> Interval:
    """Wilson's score interval of a probability, from independent trials.

    Source: Wilson, Probable inference, the law of succession, and statistical inference (JASA 1927).

    Args:
        successes: 0 to count.
        count: of trials; without any the interval is [0, 1].
        confidence: of the interval.

    Example:
        >>> share = wilson(90, 100)
        >>> round(share.lower, 4), round(share.upper, 4)
        (0.8256, 0.9448)
    """
    if count == 0:
        return Interval(np.nan, 0.0, 1.0)
    lower, upper = wilson_limits(np.asarray(successes, float), count, confidence)
    return Interval(successes / count, float(lower), float(upper))


def wilson_limits(successes: Any, count: Any, confidence: float) -> tuple[Any, Any]:
    """Limits of Wilson's interval for many numbers of successes at once."""
    z2, share = score(confidence) ** 2, successes / count
    centre = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = np.sqrt(z2 * share * (1 - share) / count + z2**2 / (4 * count**2)) / (1 + z2 / count)
    lower = np.where(successes == 0, 0.0, centre - half)  # exact where rounding would leave a crumb
    upper = np.where(successes == count, 1.0, centre + half)
    return np.maximum(lower, 0.0), np.minimum(upper, 1.0)


def mean_interval(values: Float[np.ndarray, "cases"], confidence: float = CONFIDENCE) -> Interval:
    """Student's interval of a mean, for values whose mean is nearly normal; values that are not finite are left out.

    Example:
        >>> import numpy as np
        >>> mean_interval(np.array([1.0, 2.0, 3.0])).estimate
        2.0
    """
    from scipy.special import stdtrit

    finite = values[np.isfinite(values)]
    count = len(finite)
    if count < 2:
        return Interval(float(np.mean(finite)) if count else np.nan, -np.inf, np.inf)
    half = float(stdtrit(count - 1, 0.5 + confidence / 2) * np.std(finite, ddof=1) / np.sqrt(count))
    mean = float(np.mean(finite))
    return Interval(mean, mean - half, mean + half)


def score(confidence: float) -> float:
    """Standard normal score of a two-sided interval."""
    return float(ndtri(0.5 + confidence / 2))
