"""Distributions of one number, by their quantile functions: a uniform number in, a value out.

All samplers make uniform numbers, so that every distribution works with each of them.
"""

import dataclasses
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxscp.core.arrays import is_number
from jaxscp.monte_carlo.errors import InvalidStudy

Uniforms = Float[np.ndarray, "cases"]
Real = float | int


@runtime_checkable
class Distribution(Protocol):
    """A distribution of one number."""

    def quantile(self, u: Uniforms) -> Uniforms:
        """Values whose cumulative probabilities are u, each in (0, 1)."""
        ...


def _require(holds: Any, message: str) -> None:
    if not holds:
        raise InvalidStudy(message)


def _require_numbers(distribution: Any, *fields: str) -> None:
    for field in fields:
        value = getattr(distribution, field)
        _require(
            is_number(value), f"{type(distribution).__name__}: {field} must be one number, got {value!r}."
        )


@dataclasses.dataclass(frozen=True)
class Uniform:
    """Every value between two limits is equally likely.

    Raises:
        InvalidStudy: if the limits are not in order.

    Example:
        >>> import numpy as np
        >>> Uniform(2.0, 4.0).quantile(np.array([0.25, 0.5])).tolist()
        [2.5, 3.0]
    """

    lower: Real
    upper: Real

    def __post_init__(self):
        _require_numbers(self, "lower", "upper")
        _require(-np.inf < self.lower < self.upper < np.inf, f"Uniform: lower < upper must hold, got {self}.")

    def quantile(self, u: Uniforms) -> Uniforms:
        """See ``Distribution``."""
        return self.lower + (self.upper - self.lower) * u


@dataclasses.dataclass(frozen=True)
class LogUniform:
    """A value between two positive limits whose logarithm is uniform."""

    lower: Real
    upper: Real

    def __post_init__(self):
        _require_numbers(self, "lower", "upper")
        _require(
            0 < self.lower < self.upper < np.inf, f"LogUniform: 0 < lower < upper must hold, got {self}."
        )

    def quantile(self, u: Uniforms) -> Uniforms:
        """See ``Distribution``."""
        return np.exp(np.log(self.lower) + np.log(self.upper / self.lower) * u)


@dataclasses.dataclass(frozen=True)
class Normal:
    """A normal distribution; with limits, that part of it which lies between them.

    Args:
        mean: before truncation.
        deviation: standard deviation before truncation.
        lower: least value.
        upper: greatest value.

    Raises:
        InvalidStudy: if the deviation is not positive, or no value lies between the limits.

    Example:
        >>> import numpy as np
        >>> Normal(1.0, 0.1).quantile(np.array([0.5])).tolist()
        [1.0]
        >>> bool(Normal(1.0, 0.1, lower=0.9).quantile(np.array([1e-9]))[0] >= 0.9)
        True
    """

    mean: Real
    deviation: Real
    lower: Real = -np.inf
    upper: Real = np.inf

    def __post_init__(self):
        _require_numbers(self, "mean", "deviation", "lower", "upper")
        _require(
            0 < self.deviation < np.inf and np.isfinite(self.mean),
            f"Normal: needs a finite mean and a positive deviation, got {self}.",
        )
        below, above = self._probabilities()
        _require(above - below > 1e-12, f"Normal: the limits leave no probability, got {self}.")

    def quantile(self, u: Uniforms) -> Uniforms:
        """See ``Distribution``."""
        from scipy.special import ndtri

        below, above = self._probabilities()
        return np.clip(
            self.mean + self.deviation * ndtri(below + (above - below) * u), self.lower, self.upper
        )

    def _probabilities(self) -> tuple[float, float]:
        from scipy.special import ndtr

        return tuple(float(ndtr((x - self.mean) / self.deviation)) for x in (self.lower, self.upper))  # pyright: ignore[reportReturnType]


@dataclasses.dataclass(frozen=True)
class Choice:
    """One of some values; all equally likely, or with weights."""

    values: tuple[Real, ...]
    weights: tuple[Real, ...] | None = None

    def __post_init__(self):
        for field in ("values", "weights"):
            given = getattr(self, field)
            known = isinstance(given, list | tuple | np.ndarray) and all(map(is_number, given))
            _require(
                known or (field == "weights" and given is None),
                f"Choice: {field} must be a tuple of numbers, got {given!r}.",
            )
        _require(len(self.values) > 0, "Choice: needs a value.")
        if self.weights is not None:
            _require(
                len(self.weights) == len(self.values) and min(self.weights) >= 0 and sum(self.weights) > 0,
                f"Choice: needs a weight of zero or more for each value, and a positive sum; got {self.weights}.",
            )

    def quantile(self, u: Uniforms) -> Uniforms:
        """See ``Distribution``."""
        weights = np.ones(len(self.values)) if self.weights is None else np.asarray(self.weights, float)
        steps = np.cumsum(weights)[:-1] / np.sum(weights)
        return np.asarray(self.values, float)[np.searchsorted(steps, u, side="right")]


@dataclasses.dataclass(frozen=True)
class SciPy:
    """Any frozen distribution of ``scipy.stats``.

    Raises:
        InvalidStudy: if the object has no quantile function, or its parameters are outside of their range.

    Example:
        >>> import numpy as np, scipy.stats
        >>> SciPy(scipy.stats.triang(c=0.5)).quantile(np.array([0.5])).tolist()
        [0.5]
    """

    frozen: Any

    def __post_init__(self):
        _require(
            callable(getattr(self.frozen, "ppf", None)),
            f"SciPy: expected a frozen distribution, scipy.stats.gamma(2.0) say, got {self.frozen!r}.",
        )
        if callable(support := getattr(self.frozen, "support", None)):
            # SciPy raises nothing for wrong parameters: limits and quantiles are NaN
            _require(not np.any(np.isnan(np.asarray(support(), float))), f"SciPy: {self._text()}.")

    def _text(self) -> str:
        family = getattr(getattr(self.frozen, "dist", None), "name", type(self.frozen).__name__)
        fields = getattr(self.frozen, "kwds", {})
        given = [*map(str, getattr(self.frozen, "args", ())), *(f"{k} = {v}" for k, v in fields.items())]
        return f"scipy.stats.{family} has no values for {', '.join(given)}; they are outside of their range"

    def quantile(self, u: Uniforms) -> Uniforms:
        """See ``Distribution``."""
        return np.asarray(self.frozen.ppf(u), float)
