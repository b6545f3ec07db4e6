"""How often the interval of a share holds the true probability: simulated sweeps of Bernoulli trials."""

import numpy as np

from jaxscp.monte_carlo.distributions import Real
from jaxscp.monte_carlo.intervals import CONFIDENCE, wilson_limits
from jaxscp.monte_carlo.stopping import NarrowShare, corrected_level, looks


def simulated_coverage(
    probability: float, cases: int, rule: NarrowShare | None = None, sweeps: int = 20_000, seed: int = 0
) -> tuple[float, float]:
    """Share of simulated sweeps whose interval holds the true probability, and their mean number of cases.

    Args:
        probability: of a success.
        cases: greatest number of cases of a sweep.
        rule: that ends sweeps; None for Wilson's interval after all cases.
        sweeps: to simulate.
        seed: of the simulation.

    Example:
        >>> share, cases = simulated_coverage(0.9, 1000, NarrowShare(0.1), sweeps=2000)
        >>> 0.9 < share < 1.0, cases < 1000
        (True, True)
    """
    schedule = [cases] if rule is None else looks(cases, rule.first)
    confidence = CONFIDENCE if rule is None else rule.confidence
    level = corrected_level(confidence) if len(schedule) > 1 else confidence
    width: Real = 0.0 if rule is None else rule.width
    rng = np.random.default_rng(seed)
    successes, open_, held, used = np.zeros(sweeps), np.ones(sweeps, bool), np.zeros(sweeps, bool), 0.0
    for before, count in zip([0, *schedule], schedule, strict=False):
        successes += rng.binomial(count - before, probability, sweeps)
        lower, upper = wilson_limits(successes, count, level)
        ended = open_ & ((upper - lower <= width) | (count == cases))
        held |= ended & (lower <= probability) & (probability <= upper)
        used += float(np.sum(ended)) * count
        open_ &= ~ended
    return float(np.mean(held)), used / sweeps
