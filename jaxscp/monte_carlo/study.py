"""A study: a function, its input, and the parameters that scatter. Case n is a function of the study and n alone."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
import scipy
from jaxtyping import Float

from jaxscp.aot.planner_cache import code_digest
from jaxscp.core.version import __version__
from jaxscp.monte_carlo.distributions import Real
from jaxscp.monte_carlo.errors import InvalidStudy
from jaxscp.monte_carlo.identity import described
from jaxscp.monte_carlo.outcome import STATUS, SUCCESS
from jaxscp.monte_carlo.parameters import Parameter, inserted, places_of
from jaxscp.monte_carlo.sampling import Numbers, Sampling, UnitPoints, correlated, correlation_factor


@dataclasses.dataclass(frozen=True)
class Study:
    """A function, its input, and the parameters that scatter from case to case.

    Args:
        run: a ``Planner``, ``Solves(guess)``, or any function of a case. It returns a ``Solution``, a pytree of
            numbers, or an ``Outcome`` with a trajectory.
        base: the pytree that cases change: a scenario, a problem, or any other.
        parameters: that vary.
        sampling: ``Independent(count, seed)``, ``LatinHypercube``, ``Sobol`` or ``Grid``.
        correlations: of pairs of parameters, by name: ``{("mass", "inertia"): 0.8}``. A Gaussian copula joins them: the
            number is the correlation of their normal scores, and of normal values themselves.
        units: of the numbers that ``run`` returns, by name.
        version: of your code, where functions that ``run`` calls may change: another version is another study.

    Raises:
        InvalidStudy: if a parameter is no float of the base, or names repeat.

    Example:
        >>> from jaxscp import monte_carlo as mc
        >>> study = mc.Study(
        ...     run=lambda ball: {"range": ball["speed"] ** 2 / 9.81},
        ...     base={"speed": 10.0},
        ...     parameters=[mc.Parameter(lambda b: b["speed"], mc.Uniform(9.0, 11.0), unit="m/s")],
        ...     sampling=mc.Independent(100, seed=1),
        ... )
        >>> study.names, study.count, 9.0 < study.case(42)["speed"] < 11.0
        (('speed',), 100, True)
    """

    run: Callable[[Any], Any]
    base: Any
    parameters: Sequence[Parameter]
    sampling: Sampling
    correlations: Mapping[tuple[str, str], Real] = dataclasses.field(default_factory=dict)
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    version: str = ""
    _places: tuple[int, ...] = dataclasses.field(default=(), init=False, repr=False)

    def __post_init__(self):
        if not callable(self.run):
            raise InvalidStudy(f"run: expected a planner or a function, got {self.run!r}.")
        if not isinstance(self.sampling, Sampling):
            raise InvalidStudy(f"sampling: expected Independent(count, seed), say, got {self.sampling!r}.")
        listed = isinstance(self.parameters, list | tuple)
        if not listed or not all(isinstance(parameter, Parameter) for parameter in self.parameters):
            raise InvalidStudy(f"parameters: expected a list of Parameter(...), got {self.parameters!r}.")
        parameters = tuple(parameter.resolved(self.base) for parameter in self.parameters)
        object.__setattr__(self, "parameters", parameters)
        object.__setattr__(self, "_places", places_of(self.base, parameters))
        names = list(self.names)
        reserved = {SUCCESS, STATUS, "case"}
        wrong = sorted({name for name in names if names.count(name) > 1 or name in reserved})
        if wrong:
            raise InvalidStudy(
                f"parameters: the name {wrong[0]!r} is taken; give each parameter its own name."
            )
        if self.correlations:
            correlation_factor(names, self.correlations)
            if not self.sampling.independent and hasattr(self.sampling, "points_each"):
                raise InvalidStudy("correlations: a grid has none; use Independent, LatinHypercube or Sobol.")
        self.values(np.zeros(1, int))

    @property
    def count(self) -> int:
        """Number of cases."""
        return self.sampling.count

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    def values(self, numbers: Numbers) -> UnitPoints:
        """Drawn values of some cases, (cases, parameters).

        Raises:
            InvalidStudy: if a distribution gives a value that is not finite.
        """
        points = self.sampling.points(np.asarray(numbers), len(self.parameters))
        if self.correlations:
            points = correlated(points, correlation_factor(self.names, self.correlations))
        drawn = np.empty_like(points)
        for i, parameter in enumerate(self.parameters):
            drawn[:, i] = parameter.distribution.quantile(points[:, i])
            if not np.all(np.isfinite(drawn[:, i])):
                raise InvalidStudy(
                    f"parameter {parameter.name!r}: its distribution gave a value that is not finite."
                )
        return drawn

    def case(self, number: int) -> Any:
        """The base of one case.

        Raises:
            InvalidStudy: if there is no such case.
        """
        return self.insert(self.values_of(number))

    def values_of(self, number: int) -> Float[np.ndarray, "parameters"]:
        """Drawn values of one case.

        Raises:
            InvalidStudy: if there is no such case.
        """
        whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
        if not whole or not 0 <= number < self.count:
            raise InvalidStudy(f"case {number!r}: the study has cases 0 to {self.count - 1}.")
        return self.values(np.array([number]))[0]

    def insert(self, values: Any) -> Any:
        """The base with values of the parameters, (parameters,); they may be traced."""
        return inserted(self.base, self.parameters, self._places, values)

    def identity(self) -> dict[str, Any]:
        """The study as plain data: folders compare it."""
        about = {
            field.name: described(getattr(self, field.name))
            for field in dataclasses.fields(self)
            if field.init
        }
        about["correlations"] = {f"{a}, {b}": float(v) for (a, b), v in self.correlations.items()}
        about["versions"] = {
            "jaxscp": __version__,
            "code": code_digest()[:16],
            "jax": jax.__version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "float64": bool(jax.config.jax_enable_x64),  # pyright: ignore[reportAttributeAccessIssue]
        }
        return about


class ById:
    """A study as a key: the same object is the same program."""

    def __init__(self, study: Study):
        self.study = study

    def __hash__(self) -> int:
        return id(self.study)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ById) and other.study is self.study
