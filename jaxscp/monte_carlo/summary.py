"""Statistics of a sweep: success share, quantiles, statuses with likely causes, the worst cases."""

import dataclasses
from typing import Any

import numpy as np

from jaxscp.core.errors import InvalidProblem, InvalidScenario
from jaxscp.core.status import STATUS_NAMES, Status
from jaxscp.monte_carlo.intervals import CONFIDENCE, Interval, wilson
from jaxscp.monte_carlo.outcome import STATUS, SUCCESS
from jaxscp.monte_carlo.results import Sweep
from jaxscp.monte_carlo.solves import Solves
from jaxscp.solver.planner import Planner

QUANTILES = (0.05, 0.5, 0.95)
RESAMPLES = 1000
WORST = 10
VIOLATION = "violation"
INVALID = "invalid_input"


@dataclasses.dataclass(frozen=True)
class Summary:
    """Statistics of a sweep; ``print`` shows them."""

    cases: int
    share: Interval | None
    """Of successes; its limits are NaN for cases that are not independent."""
    statuses: dict[str, int]
    """Counts by name."""
    quantiles: dict[str, dict[float, Interval]]
    """By result and probability, of successful cases; with bootstrap intervals where cases are independent."""
    violations: dict[str, float]
    """Greatest violation and error of successful cases, by name."""
    worst: list[int]
    """Cases to look at: failures first, then by violation."""
    units: dict[str, str]
    ending: str = ""
    first_invalid: str = ""
    """Why the first invalid case is invalid; empty if there is none, or the study is not at hand."""

    def text(self) -> str:
        """Lines for people."""
        lines = [f"{self.cases} cases" + (f"; {self.ending}" if self.ending else "")]
        if self.share is not None:
            lines.append(f"success: {_percent(self.share)}")
        for name, count in self.statuses.items():
            cause = "" if name == "converged" else f": {Status[getattr(Status, name)]}"
            if name == INVALID and self.first_invalid:
                cause = f": {self.first_invalid}"
            lines.append(f"  {count:>7} {name}{cause}")
        for name, row in self.quantiles.items():
            unit = f" {self.units[name]}" if self.units.get(name) else ""
            lines.append(
                f"{name}{unit}: " + ", ".join(f"{100 * p:g} %: {_number(v)}" for p, v in row.items())
            )
        if self.violations:
            rows = ", ".join(f"{name} {value:.3g}" for name, value in self.violations.items())
            lines.append(f"greatest of successful cases: {rows}")
        if self.worst:
            lines.append(f"worst cases: {', '.join(map(str, self.worst))}")
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.text()

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        quantiles = {n: {str(p): list(v) for p, v in row.items()} for n, row in self.quantiles.items()}
        about = dataclasses.asdict(self) | {"quantiles": quantiles, "share": self.share and list(self.share)}
        return _finite(about)


def summarise(sweep: Sweep, confidence: float = CONFIDENCE, resamples: int = RESAMPLES) -> Summary:
    """Statistics of a sweep.

    Args:
        sweep: its results.
        confidence: of all intervals. A stop rule that ended the sweep gives the share's interval itself.
        resamples: of the bootstrap (``scipy.stats.bootstrap``, percentile method); 0 for no intervals of quantiles.
    """
    results = {name: sweep.values(name) for name in sweep.results}
    count = sweep.complete
    success = results.get(SUCCESS)
    good = np.ones(count, bool) if success is None else success.astype(bool)
    numeric = {
        name: values
        for name, values in results.items()
        if np.issubdtype(values.dtype, np.floating) and not _of_certificate(name)
    }
    resamples = resamples if sweep.independent else 0
    return Summary(
        cases=count,
        share=None if success is None else _share(sweep, good, confidence),
        statuses=_statuses(results.get(STATUS)),
        quantiles={name: _quantiles(values[good], confidence, resamples) for name, values in numeric.items()},
        violations={
            name: float(np.nanmax(values[good]))
            for name, values in results.items()
            if _of_certificate(name) and np.any(np.isfinite(values[good]))
        },
        worst=_worst(sweep.numbers, good, results.get(VIOLATION)),
        units={name: quantity.unit for name, quantity in sweep.layout.quantities.items()},
        ending="" if sweep.ending is None else sweep.ending.reason,
        first_invalid=_first_invalid(sweep, results.get(STATUS)),
    )


def _share(sweep: Sweep, good: np.ndarray, confidence: float) -> Interval:
    if not sweep.independent:
        return Interval(float(np.mean(good)), np.nan, np.nan)
    ending = sweep.ending
    if ending is not None and ending.interval is not None and ending.of == SUCCESS:
        return ending.interval
    return wilson(int(np.sum(good)), len(good), confidence)


def _statuses(codes: np.ndarray | None) -> dict[str, int]:
    if codes is None or not np.issubdtype(codes.dtype, np.integer):
        return {}
    found, counts = np.unique(codes, return_counts=True)
    order = np.argsort(-counts)
    return {STATUS_NAMES[found[i]]: int(counts[i]) for i in order}


def _first_invalid(sweep: Sweep, codes: np.ndarray | None) -> str:
    """Message of the check of the first invalid case: it takes milliseconds, and compiles nothing."""
    run = None if sweep.study is None else sweep.study.run
    if not isinstance(run, Planner | Solves) or INVALID not in _statuses(codes):
        return ""
    number = int(np.min(sweep.numbers[codes == STATUS_NAMES.index(INVALID)]))
    case = sweep.case(number)
    try:
        case.check(run.nodes_for(case)) if isinstance(run, Planner) else run.check(case)
    except (InvalidScenario, InvalidProblem) as error:
        return f"case {number}, {'; '.join(str(error).splitlines())}"
    return ""


def _quantiles(values: np.ndarray, confidence: float, resamples: int) -> dict[float, Interval]:
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return {}
    estimates = np.quantile(finite, QUANTILES)
    if resamples == 0 or len(finite) < 2 or np.ptp(finite) == 0:
        return {p: Interval(float(v), np.nan, np.nan) for p, v in zip(QUANTILES, estimates, strict=True)}
    from scipy.stats import bootstrap

    found = bootstrap(
        (finite,),
        lambda sample, axis: np.quantile(sample, QUANTILES, axis=axis),
        confidence_level=confidence,
        n_resamples=resamples,
        batch=max(1, 1_000_000 // len(finite)),  # flat memory
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    rows = zip(QUANTILES, estimates, found.low, found.high, strict=True)
    return {p: Interval(float(v), float(low), float(high)) for p, v, low, high in rows}


def _worst(numbers: np.ndarray, good: np.ndarray, violation: np.ndarray | None) -> list[int]:
    """Failures by descending violation, unknown ones first; then successes by descending violation."""
    size = np.zeros(len(numbers)) if violation is None else np.where(np.isnan(violation), np.inf, violation)
    order = np.lexsort((numbers, -size, good))
    enough = order if violation is not None else order[~good[order]]
    return [int(numbers[i]) for i in enough[:WORST]]


def _of_certificate(name: str) -> bool:
    """Whether a result is a row of the certificate."""
    return name.startswith(("violation", "error_", "defect"))


def _percent(share: Interval) -> str:
    text = f"{100 * share.estimate:.2f} %"
    return text if np.isnan(share.lower) else f"{text} ({100 * share.lower:.2f} to {100 * share.upper:.2f} %)"


def _number(value: Interval) -> str:
    text = f"{value.estimate:.4g}"
    return text if np.isnan(value.lower) else f"{text} ({value.lower:.4g} to {value.upper:.4g})"


def _finite(value: Any) -> Any:
    """Numbers that JSON cannot hold become null."""
    if isinstance(value, dict):
        return {key: _finite(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
