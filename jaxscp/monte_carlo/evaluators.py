"""How one process runs cases: one after another, or many at once under ``vmap``."""

import dataclasses
import functools
import time
from typing import Any

import jax
import numpy as np

from jaxscp.aot.aot import batched
from jaxscp.core.status import STATUS_NAMES
from jaxscp.core.threads import in_order, usable_cores
from jaxscp.monte_carlo.errors import SweepError
from jaxscp.monte_carlo.outcome import (
    STATUS,
    Outcome,
    Quantity,
    as_arrays,
    outcome_of,
    quantities,
    traced_arrays,
    units_of,
)
from jaxscp.monte_carlo.sampling import Numbers, UnitPoints
from jaxscp.monte_carlo.solves import Solves
from jaxscp.monte_carlo.study import ById, Study
from jaxscp.planner.planner import Planner
from jaxscp.problem.errors import InvalidProblem, InvalidScenario


@dataclasses.dataclass(frozen=True)
class OneByOne:
    """Single cases, one after another on each thread: fastest on a CPU, and the way for functions that are not JAX.

    Args:
        workers: threads; by default all usable cores for planners, and one for a function that may not be safe there.
            Results do not depend on it.
    """

    workers: int | None = None

    def __post_init__(self):
        if self.workers is not None and self.workers < 1:
            raise ValueError(f"OneByOne: workers must be 1 or more, got {self.workers}")

    def quantities(self, study: Study) -> dict[str, Quantity]:
        """See ``Evaluator``. Runs the base once, which also compiles."""
        value = jax.block_until_ready(study.run(study.base))
        return quantities(outcome_of(value), units_of(value) | dict(study.units))

    def evaluate(
        self, study: Study, numbers: Numbers, drawn: UnitPoints, stored: dict[str, Quantity]
    ) -> tuple[dict[str, np.ndarray], float]:
        """See ``Evaluator``.

        Raises:
            SweepError: if the function fails; the message names the case.
        """

        def one(case: tuple[Any, Any]) -> tuple[dict[str, np.ndarray], float]:
            return _row(study, *case, stored)

        cases = zip(numbers, drawn, strict=True)
        rows, seconds = zip(*in_order(one, cases, self._threads(study)), strict=True)
        return {name: np.stack([row[name] for row in rows]) for name in rows[0]}, sum(seconds)

    def _threads(self, study: Study) -> int:
        safe = isinstance(study.run, Planner | Solves)
        return self.workers or (usable_cores() if safe else 1)


def _row(
    study: Study, number: Any, drawn: Any, stored: dict[str, Quantity]
) -> tuple[dict[str, np.ndarray], float]:
    """Results of one case, and seconds inside ``study.run``."""
    case = study.insert(drawn)
    began = time.perf_counter()
    try:
        value = jax.block_until_ready(study.run(case))
        seconds = time.perf_counter() - began
        return as_arrays(outcome_of(jax.device_get(value))), seconds  # one copy, and no compiled indexing
    except (InvalidScenario, InvalidProblem) as error:
        if STATUS not in stored:
            raise SweepError(f"case {number}: {error}") from error
        return _invalid(stored), 0.0  # as under vmap
    except Exception as error:
        raise SweepError(f"case {number}: run failed, {type(error).__name__}: {error}") from error


def _invalid(stored: dict[str, Quantity]) -> dict[str, np.ndarray]:
    """Results of a case that contradicts itself: NaN, and the status that says so."""

    def empty(quantity: Quantity) -> np.ndarray:
        floating = np.issubdtype(quantity.dtype, np.floating)
        return np.full(quantity.shape, np.nan if floating else 0, quantity.dtype)

    code = np.asarray(STATUS_NAMES.index("invalid_input"), stored[STATUS].dtype)
    return {name: empty(quantity) for name, quantity in stored.items()} | {STATUS: code}


@dataclasses.dataclass(frozen=True)
class Together:
    """Many cases at once, by ``jax.vmap``; over several devices by ``jax.shard_map``. For GPUs.

    Args:
        size: cases of the compiled program; a last part is padded.
        devices: of one platform; JAX's default one if empty.
    """

    size: int = 1024
    devices: tuple[Any, ...] = ()

    def __post_init__(self):
        if self.size < 1 or self.size % max(len(self.devices), 1):
            raise ValueError(
                f"Together: size must be a positive multiple of {max(len(self.devices), 1)}, got {self.size}"
            )

    def quantities(self, study: Study) -> dict[str, Quantity]:
        """See ``Evaluator``. Traces, and runs nothing."""
        units: dict[str, str] = {}

        def one(row: Any) -> Outcome:
            value = study.run(study.insert(row))
            units.update(units_of(value))
            return outcome_of(value)

        row = jax.ShapeDtypeStruct((len(study.parameters),), float)
        return quantities(jax.eval_shape(one, row), units | dict(study.units))

    def evaluate(
        self, study: Study, numbers: Numbers, drawn: UnitPoints, stored: dict[str, Quantity]
    ) -> tuple[dict[str, np.ndarray], float]:
        """See ``Evaluator``."""
        began, parts = time.perf_counter(), []
        program = _batched(self, ById(study))
        for start in range(0, len(drawn), self.size):
            rows = drawn[start : start + self.size]
            padded = np.concatenate([rows, np.repeat(rows[-1:], self.size - len(rows), axis=0)])
            found = jax.device_get(program(padded))
            parts.append({name: array[: len(rows)] for name, array in found.items()})
        busy = time.perf_counter() - began
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}, busy


@functools.lru_cache(maxsize=2)
def _batched(how: Together, key: ById) -> Any:
    """The compiled program of a study's batch."""

    def one(row: Any) -> dict[str, jax.Array]:
        return traced_arrays(outcome_of(key.study.run(key.study.insert(row))))

    return jax.jit(batched(one, how.devices))
