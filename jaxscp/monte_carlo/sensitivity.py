"""Which parameters a result depends on: rank correlations, Sobol indices, and gradients of single cases."""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.monte_carlo.errors import InvalidStudy, extra
from jaxscp.monte_carlo.intervals import score
from jaxscp.monte_carlo.outcome import outcome_of
from jaxscp.monte_carlo.results import Sweep, study_of
from jaxscp.monte_carlo.sampling import Numbers, UnitPoints
from jaxscp.monte_carlo.study import ById, Study


class Effect(NamedTuple):
    """Effect of a parameter on a result."""

    parameter: str
    value: float
    lower: float
    upper: float


def rank_correlations(sweep: Sweep, result: str, confidence: float = 0.95) -> list[Effect]:
    """Spearman's rank correlation of each parameter with a result, the strongest first.

    Intervals: Fisher's z with the variance of Bonett and Wright (Psychometrika 2000). Cases whose result is not finite
    are left out.

    Args:
        sweep: its results.
        result: name; a boolean counts as 0 and 1.
        confidence: of the intervals.

    Raises:
        SweepError: if there is no such result.
    """
    from scipy.stats import spearmanr

    values = sweep.values(result).astype(float)
    finite, found = np.isfinite(values), []
    for name in sweep.parameters:
        drawn = sweep.values(name)[finite]
        if len(drawn) < 4 or np.ptp(drawn) == 0 or np.ptp(values[finite]) == 0:
            found.append(Effect(name, np.nan, np.nan, np.nan))
            continue
        r = float(spearmanr(drawn, values[finite]).statistic)  # pyright: ignore[reportAttributeAccessIssue]
        half = score(confidence) * np.sqrt((1 + r**2 / 2) / (len(drawn) - 3))
        z = np.arctanh(np.clip(r, -1 + 1e-15, 1 - 1e-15))
        # Near one, rounding may put a limit on the wrong side of the value.
        lower, upper = min(r, float(np.tanh(z - half))), max(r, float(np.tanh(z + half)))
        found.append(Effect(name, r, lower, upper))
    return sorted(found, key=lambda effect: -abs(np.nan_to_num(effect.value)))


@dataclasses.dataclass(frozen=True)
class Saltelli:
    """The design of Saltelli for Sobol indices (SALib): ``size`` (parameters + 2) cases.

    Source: Saltelli et al., Variance based sensitivity analysis of model output (Computer Physics Communications 2010).

    Args:
        size: of the base sample, a power of two.
        dimensions: number of parameters of the study.
        seed: zero or more.
    """

    size: int
    dimensions: int
    seed: int = 0
    independent: bool = dataclasses.field(default=False, init=False)

    def __post_init__(self):
        if self.size < 2 or self.size & (self.size - 1):
            raise InvalidStudy(f"Saltelli: size must be a power of two, got {self.size}.")

    @property
    def count(self) -> int:
        """Number of cases."""
        return self.size * (self.dimensions + 2)

    def points(self, numbers: Numbers, dimensions: int) -> UnitPoints:
        """See ``Sampling``."""
        if dimensions != self.dimensions:
            raise InvalidStudy(
                f"Saltelli: dimensions is {self.dimensions}, but the study has {dimensions} parameters."
            )
        found = extra("SALib.sample.sobol").sample(
            _problem([f"x{i}" for i in range(dimensions)]), self.size, calc_second_order=False, seed=self.seed
        )
        return np.clip(found, 1e-15, 1.0 - 1e-15)[numbers]


def sobol_indices(sweep: Sweep, result: str) -> dict[str, list[Effect]]:
    """First-order and total Sobol indices of each parameter (SALib), with 95 % bootstrap intervals.

    Args:
        sweep: of a study with ``Saltelli`` sampling and no correlations, complete.
        result: name; finite in all cases.

    Returns:
        Effects by ``"first"`` and ``"total"``.

    Raises:
        InvalidStudy: if the sweep is of another design, or incomplete, or a value is not finite.
    """
    sampling = None if sweep.study is None else sweep.study.sampling
    if not isinstance(sampling, Saltelli) or sweep.complete != sampling.count:
        raise InvalidStudy("sobol_indices: needs a complete sweep with its study, of Saltelli sampling.")
    if sweep.study is not None and sweep.study.correlations:
        raise InvalidStudy(
            "sobol_indices: parameters that are correlated share their effects; it needs none."
        )
    values = sweep.values(result).astype(float)
    if not np.all(np.isfinite(values)):
        raise InvalidStudy(
            f"sobol_indices: {np.sum(~np.isfinite(values))} values of {result} are not finite."
        )
    names = sweep.parameters
    found = extra("SALib.analyze.sobol").analyze(
        _problem(names), values, calc_second_order=False, seed=sampling.seed, print_to_console=False
    )

    def effects(value: str) -> list[Effect]:
        rows = zip(names, found[value], found[f"{value}_conf"], strict=True)
        return [Effect(n, float(v), float(v - half), float(v + half)) for n, v, half in rows]

    return {"first": effects("S1"), "total": effects("ST")}


def _problem(names: list[str]) -> dict[str, Any]:
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}


def gradient(sweep: Sweep | Study, number: int, of: str) -> dict[str, float]:
    """Derivatives of one result of one case with respect to each parameter, by ``jax.grad``.

    Of a plan in the default mode, these are implicit derivatives of the optimum. They compile once for a study.

    Args:
        sweep: with its study, or the study; its ``run`` must be a JAX function.
        number: of the case.
        of: name of the result.

    Raises:
        InvalidStudy: if there is no such case or result, or the sweep was opened without its study.

    Example:
        >>> from jaxscp import monte_carlo as mc
        >>> study = mc.Study(lambda c: {"y": c["x"] ** 2}, {"x": 3.0}, [mc.Parameter("x", mc.Choice((3.0,)))],
        ...                  mc.Independent(1))
        >>> mc.gradient(study, 0, "y")
        {'x': 6.0}
    """
    study = study_of(sweep)
    found = _gradient(ById(study), of)(jnp.asarray(study.values_of(number)))
    return {name: float(value) for name, value in zip(study.names, found, strict=True)}


@functools.lru_cache(maxsize=8)
def _gradient(key: ById, of: str) -> Any:
    def value(drawn: Any) -> Any:
        scalars = outcome_of(key.study.run(key.study.insert(drawn))).scalars
        if of not in scalars:
            raise InvalidStudy(f"no result is called {of!r}; there are {', '.join(scalars)}.")
        return scalars[of]

    return jax.jit(jax.grad(value))
