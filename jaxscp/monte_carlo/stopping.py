"""When a sweep has enough cases: rules that look at the results at 1, 2, 4, 8 ... times a first number of cases.

A rule that stops at a narrow interval looks several times, so that each interval has a higher level than the one asked
for. The level holds for rules that stop by the width: of two neighbouring looks, n and 2 n cases, the estimates have
the correlation 1/sqrt(2), and the worst threshold between them sets the level.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from jaxscp.monte_carlo.distributions import Real
from jaxscp.monte_carlo.errors import InvalidStudy
from jaxscp.monte_carlo.intervals import CONFIDENCE, Interval, mean_interval, score, wilson
from jaxscp.monte_carlo.outcome import SUCCESS

MOST_CONFIDENCE = 1.0 - 1e-9
"""Greater levels have no interval in double precision."""


@dataclasses.dataclass(frozen=True)
class Observed:
    """State of a sweep, as a rule sees it.

    Args:
        complete: cases 0 to complete - 1 are all computed.
        count: of the study.
        seconds: since this call of ``sweep`` began.
        first: from the name of a result and n to its values in cases 0 to n - 1.
    """

    complete: int
    count: int
    seconds: float
    first: Callable[[str, int], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Ending:
    """Why and where a sweep ended: at cases 0 to ``cases`` - 1."""

    cases: int
    reason: str
    interval: Interval | None = None
    of: str = ""
    """Name of the result that the interval is of."""


@runtime_checkable
class Stop(Protocol):
    """A rule."""

    @property
    def independent(self) -> bool:
        """Whether it holds for independent cases only."""
        ...

    def ended(self, observed: Observed) -> Ending | None:
        """Where the sweep ends; None to go on. Looks again at all looks so far: it keeps no state."""
        ...


@dataclasses.dataclass(frozen=True)
class NarrowShare:
    """Stop when Wilson's interval of a share is narrow enough.

    Args:
        width: upper limit less lower limit.
        of: name of a boolean result.
        confidence: that the final interval has, looks included.
        first: cases at the first look; an eighth of the count by default. Of few cases, Wilson's interval of a share
            near zero or one holds less often: ``simulated_coverage`` says how often.

    Raises:
        InvalidStudy: a number is out of its range.

    Example:
        >>> looks(1000, None)
        [125, 250, 500, 1000]
    """

    width: Real
    of: str = SUCCESS
    confidence: float = CONFIDENCE
    first: int | None = None
    independent: bool = dataclasses.field(default=True, init=False)

    def ended(self, observed: Observed) -> Ending | None:
        """See ``Stop``."""
        return _narrow(self, observed, self._interval)

    def __post_init__(self) -> None:
        """Check the numbers."""
        _check_rule(self)

    def _interval(self, values: np.ndarray, level: float) -> Interval:
        if values.dtype != bool:
            raise InvalidStudy(f"of: {self.of} has the type {values.dtype}; a share is of a boolean result.")
        return wilson(int(np.sum(values)), len(values), level)


@dataclasses.dataclass(frozen=True)
class NarrowMean:
    """Stop when Student's interval of a mean is narrow enough.

    Args:
        of: name of a result.
        width: upper limit less lower limit, in its unit.
        confidence: that the final interval has, looks included, for many cases.
        first: cases at the first look; an eighth of the count by default.

    Raises:
        InvalidStudy: a number is out of its range.
    """

    of: str
    width: Real
    confidence: float = CONFIDENCE
    first: int | None = None
    independent: bool = dataclasses.field(default=True, init=False)

    def __post_init__(self) -> None:
        """Check the numbers."""
        _check_rule(self)

    def ended(self, observed: Observed) -> Ending | None:
        """See ``Stop``."""
        return _narrow(self, observed, mean_interval)


@dataclasses.dataclass(frozen=True)
class Budget:
    """Stop after some seconds of this call; resumed sweeps get as many again.

    Raises:
        InvalidStudy: the number is not positive.
    """

    seconds: Real
    independent: bool = dataclasses.field(default=False, init=False)

    def __post_init__(self) -> None:
        """Check the number."""
        _check_positive("seconds", self.seconds)

    def ended(self, observed: Observed) -> Ending | None:
        """See ``Stop``."""
        if observed.seconds < self.seconds or observed.complete == 0:
            return None
        return Ending(observed.complete, f"the budget of {self.seconds:g} s is spent")


def _check_positive(name: str, value: Real) -> None:
    if not 0.0 < value < np.inf:  # NaN is refused, too
        raise InvalidStudy(f"{name}: must be positive and finite, got {value}.")


def _check_rule(rule: NarrowShare | NarrowMean) -> None:
    _check_positive("width", rule.width)
    if rule.first is not None and rule.first < 1:
        raise InvalidStudy(f"first: must be 1 or more, got {rule.first}.")
    corrected_level(rule.confidence)


def looks(count: int, first: int | None) -> list[int]:
    """Numbers of cases at which a rule looks: doubled each time, and all cases at last."""
    size, found = max(2, first if first is not None else -(-count // 8)), []
    while size < count:
        found.append(size)
        size *= 2
    return [*found, count]


def _narrow(
    rule: NarrowShare | NarrowMean, observed: Observed, interval: Callable[[np.ndarray, float], Interval]
) -> Ending | None:
    schedule = looks(observed.count, rule.first)
    level = corrected_level(rule.confidence) if len(schedule) > 1 else rule.confidence
    for cases in schedule:
        if cases > observed.complete:
            return None
        found = interval(observed.first(rule.of, cases), level)
        if found.width <= rule.width:
            return Ending(cases, f"the interval of {rule.of} is narrower than {rule.width:g}", found, rule.of)
    return Ending(observed.count, "all cases are computed", found, rule.of)


@functools.cache
def corrected_level(confidence: float) -> float:
    """Level of each look's interval, so that the interval at the end has this confidence.

    Example:
        >>> round(corrected_level(0.95), 4)
        0.9628
    """
    if not 0.5 <= confidence <= MOST_CONFIDENCE:
        raise InvalidStudy(f"confidence: must lie in [0.5, {MOST_CONFIDENCE}], got {confidence}.")
    plain = score(confidence)
    z = float(brentq(lambda z: least_coverage(z) - confidence, plain, plain + 2.0))  # pyright: ignore[reportArgumentType]
    return 2.0 * float(ndtr(z)) - 1.0


def least_coverage(z: float) -> float:
    """Least coverage over all thresholds c of: stop at the first look if its error exceeds c, else at the second.

    Errors of the two looks are standard normal with correlation 1/sqrt(2); the intervals are +-z.
    """
    error = np.linspace(-8.0, 8.0, 8001)
    density = np.exp(-0.5 * error**2) / np.sqrt(2.0 * np.pi) * (error[1] - error[0])
    mean, deviation = error * np.sqrt(0.5), np.sqrt(0.5)
    at_second = density * (ndtr((z - mean) / deviation) - ndtr((-z - mean) / deviation))
    at_first = density * (np.abs(error) < z)
    return float(np.min(np.cumsum(at_second) + np.sum(at_first) - np.cumsum(at_first)))
