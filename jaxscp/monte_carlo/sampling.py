"""Samplers: which uniform numbers a case gets. The numbers of case n depend on the sampler and n alone."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from jaxscp.core.arrays import is_whole
from jaxscp.monte_carlo.distributions import Real
from jaxscp.monte_carlo.errors import InvalidStudy

Numbers = Int[np.ndarray, "cases"]
UnitPoints = Float[np.ndarray, "cases parameters"]

_MOST_SEED = 2**128 - 1  # the key of a Philox generator
_INSIDE = 2.0**-54  # half a step of 53 random bits: moves them from [0, 1) into (0, 1)


@runtime_checkable
class Sampling(Protocol):
    """Points of the unit cube, one a case."""

    @property
    def count(self) -> int:
        """Number of cases."""
        ...

    @property
    def independent(self) -> bool:
        """Whether cases are independent, so that intervals of shares and means hold."""
        ...

    def points(self, numbers: Numbers, dimensions: int) -> UnitPoints:
        """The points of these cases, each number in (0, 1)."""
        ...


@dataclasses.dataclass(frozen=True)
class _Seeded:
    """A number of cases, drawn from a seed."""

    count: int
    seed: int = 0

    def __post_init__(self):
        for field, least in (("count", 1), ("seed", 0)):
            value = getattr(self, field)
            if not is_whole(value, least):
                raise InvalidStudy(
                    f"{type(self).__name__}: {field} must be a whole number, {least} or more, got {value!r}."
                )
        if self.seed > _MOST_SEED:
            raise InvalidStudy(f"{type(self).__name__}: seed must be less than 2^128, got {self.seed}.")


@dataclasses.dataclass(frozen=True)
class Independent(_Seeded):
    """Independent cases: NumPy's Philox counter generator, keyed by the seed, its counter set by the case's number.

    Source: Salmon et al., Parallel random numbers: as easy as 1, 2, 3 (SC11).

    Args:
        count: number of cases; a larger count keeps the cases of a smaller one.
        seed: zero or more.

    Example:
        >>> import numpy as np
        >>> few, many = Independent(10, seed=7), Independent(1000, seed=7)
        >>> bool(np.all(few.points(np.array([3]), 2) == many.points(np.arange(9), 2)[3]))
        True
    """

    independent: bool = dataclasses.field(default=True, init=False)

    def points(self, numbers: Numbers, dimensions: int) -> UnitPoints:
        """See ``Sampling``."""
        rows, bits = np.empty((len(numbers), dimensions)), np.random.Philox(key=self.seed)
        # one generator, set anew for each case: one for each case takes eight times as long
        generator, state = np.random.Generator(bits), bits.state
        for row, number in zip(rows, numbers.tolist(), strict=True):
            state["state"]["counter"][1] = number  # 2^64 draws lie between the counters of two cases
            bits.state = state
            generator.random(out=row)
        return rows + _INSIDE


@dataclasses.dataclass(frozen=True)
class LatinHypercube(_Seeded):
    """A Latin hypercube (``scipy.stats.qmc``): each parameter has one case in each of ``count`` equal slices."""

    independent: bool = dataclasses.field(default=False, init=False)

    def points(self, numbers: Numbers, dimensions: int) -> UnitPoints:
        """See ``Sampling``."""
        return _hypercube(self.count, self.seed, dimensions)[numbers]


@dataclasses.dataclass(frozen=True)
class Sobol(_Seeded):
    """A scrambled Sobol sequence (``scipy.stats.qmc``); a power of two of cases is balanced."""

    independent: bool = dataclasses.field(default=False, init=False)

    def points(self, numbers: Numbers, dimensions: int) -> UnitPoints:
        """See ``Sampling``."""
        return _sobol(self.count, self.seed, dimensions)[numbers]


@dataclasses.dataclass(frozen=True)
class Grid:
    """All combinations of values: the middles of equal slices of probability of each parameter.

    Args:
        points_each: number of values of each parameter, in the study's order; the last one varies fastest. A
            ``Choice`` with as many equally likely values gives exactly these.

    Example:
        >>> import numpy as np
        >>> Grid((2, 2)).points(np.arange(4), 2).tolist()
        [[0.25, 0.25], [0.25, 0.75], [0.75, 0.25], [0.75, 0.75]]
    """

    points_each: tuple[int, ...]
    independent: bool = dataclasses.field(default=False, init=False)

    def __post_init__(self):
        known = isinstance(self.points_each, list | tuple) and len(self.points_each) > 0
        if not known or not all(is_whole(number, 1) for number in self.points_each):
            raise InvalidStudy(
                f"Grid: points_each must be a tuple of positive whole numbers, one for each parameter, got "
                f"{self.points_each!r}."
            )

    @property
    def count(self) -> int:
        """Product of the numbers of values."""
        return int(np.prod(self.points_each))

    def points(self, numbers: Numbers, dimensions: int) -> UnitPoints:
        """See ``Sampling``."""
        if dimensions != len(self.points_each):
            raise InvalidStudy(
                f"Grid: has {len(self.points_each)} numbers, but the study has {dimensions} parameters."
            )
        index = np.stack(np.unravel_index(numbers, self.points_each), axis=1)
        return (index + 0.5) / np.asarray(self.points_each)


def correlation_factor(
    names: Sequence[str], pairs: Mapping[tuple[str, str], Real]
) -> Float[np.ndarray, "parameters parameters"]:
    """Cholesky factor of the correlation matrix of a Gaussian copula.

    Args:
        names: of the parameters, in order.
        pairs: correlation of the normal scores of two parameters, by their names; zero for all other pairs.

    Raises:
        InvalidStudy: for an unknown name, or numbers that contradict each other.
    """
    matrix = np.eye(len(names))
    for (first, second), value in pairs.items():
        for name in (first, second):
            if name not in names:
                raise InvalidStudy(
                    f"correlations: no parameter is called {name!r}; there are {', '.join(names)}."
                )
        if pairs.get((second, first), value) != value:
            raise InvalidStudy(
                f"correlations: ({first!r}, {second!r}) is given twice, with different numbers."
            )
        if first == second or not -1.0 < value < 1.0:
            raise InvalidStudy(
                f"correlations: ({first!r}, {second!r}) needs two parameters and a number within (-1, 1), got {value}."
            )
        i, j = names.index(first), names.index(second)
        matrix[i, j] = matrix[j, i] = value
    try:
        return np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError as error:
        raise InvalidStudy(
            "correlations: no joint distribution has all of them (the matrix is not positive definite)."
        ) from error


def correlated(points: UnitPoints, factor: Float[np.ndarray, "parameters parameters"]) -> UnitPoints:
    """Points with uniform margins and a Gaussian copula, from independent points."""
    from scipy.special import ndtr, ndtri

    scores = ndtri(points)
    # column by column: a product of matrices rounds a row differently with the number of rows
    joint = [
        sum(weight * scores[:, j] for j, weight in enumerate(row[: i + 1])) for i, row in enumerate(factor)
    ]
    return np.clip(ndtr(np.stack(joint, axis=1)), _INSIDE, 1.0 - _INSIDE)


@functools.lru_cache(maxsize=2)
def _hypercube(count: int, seed: int, dimensions: int) -> np.ndarray:
    from scipy.stats import qmc

    return _inside(qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed)).random(count))


@functools.lru_cache(maxsize=2)
def _sobol(count: int, seed: int, dimensions: int) -> np.ndarray:
    from scipy.stats import qmc

    # whole powers of two: other counts make SciPy warn, and the first points are the same
    power = max(int(np.ceil(np.log2(count))), 0)
    return _inside(qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random_base2(power)[:count])


def _inside(points: np.ndarray) -> np.ndarray:
    return np.clip(points, _INSIDE, 1.0 - _INSIDE)
