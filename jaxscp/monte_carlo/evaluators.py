"""How one process runs cases: one after another, or many at once under ``vmap``."""

import contextlib
import dataclasses
import functools
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from jaxscp.aot.aot import batched
from jaxscp.core.errors import InvalidProblem, InvalidScenario
from jaxscp.core.status import STATUS_NAMES
from jaxscp.core.threads import in_order, usable_cores
from jaxscp.monte_carlo.errors import InvalidStudy, SweepError
from jaxscp.monte_carlo.outcome import (
    STATUS,
    SUCCESS,
    Outcome,
    Quantity,
    as_arrays,
    check_results,
    outcome_of,
    quantities,
    traced_arrays,
    units_of,
)
from jaxscp.monte_carlo.sampling import Numbers, UnitPoints
from jaxscp.monte_carlo.solves import Solves
from jaxscp.monte_carlo.study import ById, Study
from jaxscp.solver.planner import Planner

_WORDS = {
    "b": "a boolean",
    "i": "a whole number",
    "u": "a whole number",
    "f": "a float",
    "c": "a complex number",
}


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
        """See ``Evaluator``. Runs the base once, which also compiles.

        Raises:
            SweepError: if the function fails on the base, or returns other things than numbers.
        """
        with _blaming("the base"):
            value = jax.block_until_ready(study.run(study.base))
            outcome = outcome_of(jax.device_get(value))
        found = quantities(outcome, units_of(value) | dict(study.units))
        check_results(found)
        agreeing(_as_one(outcome), found, lambda i: "the base")
        return found

    def evaluate(
        self, study: Study, numbers: Numbers, drawn: UnitPoints, stored: dict[str, Quantity]
    ) -> tuple[dict[str, np.ndarray], float]:
        """See ``Evaluator``.

        Raises:
            SweepError: if the function fails, or its results differ from the base's in name, type or shape; the
                message names the case.
        """

        def one(case: tuple[Any, Any]) -> tuple[dict[str, np.ndarray], float]:
            return _row(study, *case, stored)

        cases = zip(numbers, drawn, strict=True)
        rows, seconds = zip(*in_order(one, cases, self._threads(study)), strict=True)
        return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}, sum(seconds)

    def _threads(self, study: Study) -> int:
        safe = isinstance(study.run, Planner | Solves)
        return self.workers or (usable_cores() if safe else 1)


def _row(
    study: Study, number: Any, drawn: Any, stored: dict[str, Quantity]
) -> tuple[dict[str, np.ndarray], float]:
    """Results of one case, and seconds inside ``study.run``."""
    place = f"case {number}"
    with _blaming(place):
        case = study.insert(drawn)
        began = time.perf_counter()
        try:
            value = jax.block_until_ready(study.run(case))
        except (InvalidScenario, InvalidProblem):
            if STATUS not in stored:
                raise
            return _invalid(stored), 0.0  # as under vmap
        seconds = time.perf_counter() - began
        found = _as_one(outcome_of(jax.device_get(value)))  # one copy, and no compiled indexing
    return agreeing(found, stored, lambda i: place), seconds


def _as_one(outcome: Outcome) -> dict[str, np.ndarray]:
    """Results of one case, (1, ...) each."""
    return {name: array[None] for name, array in as_arrays(outcome).items()}


@contextlib.contextmanager
def _blaming(place: str) -> Iterator[None]:
    """Errors of a study's function become a ``SweepError`` that says where."""
    try:
        yield
    except (InvalidScenario, InvalidProblem, InvalidStudy) as error:
        raise SweepError(f"{place}: {error}") from error
    except Exception as error:
        raise SweepError(f"{place}: run failed, {type(error).__name__}: {error}") from error


def _invalid(stored: dict[str, Quantity]) -> dict[str, np.ndarray]:
    """Results of a case that contradicts itself: NaN, and the status that says so."""

    def empty(quantity: Quantity) -> np.ndarray:
        floating = np.issubdtype(quantity.dtype, np.floating)
        return np.full((1, *quantity.shape), np.nan if floating else 0, quantity.dtype)

    code = np.full(1, STATUS_NAMES.index("invalid_input"), stored[STATUS].dtype)
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
        """See ``Evaluator``. Traces, and runs nothing.

        Raises:
            SweepError: if the function cannot be traced, or returns other things than numbers.
        """
        units: dict[str, str] = {}

        def one(row: Any) -> Outcome:
            value = study.run(study.insert(row))
            units.update(units_of(value))
            return outcome_of(value)

        row = jax.ShapeDtypeStruct((len(study.parameters),), float)
        with _blaming("the base"):
            outcome = jax.eval_shape(one, row)
        found = quantities(outcome, units | dict(study.units))
        check_results(found)
        return found

    def evaluate(
        self, study: Study, numbers: Numbers, drawn: UnitPoints, stored: dict[str, Quantity]
    ) -> tuple[dict[str, np.ndarray], float]:
        """See ``Evaluator``.

        Raises:
            SweepError: if the function fails, or its results differ from the base's in name, type or shape.
        """
        began, parts = time.perf_counter(), []
        program = _batched(self, ById(study))
        for start in range(0, len(drawn), self.size):
            rows = drawn[start : start + self.size]
            padded = np.concatenate([rows, np.repeat(rows[-1:], self.size - len(rows), axis=0)])
            place = functools.partial(_place, numbers[start:])
            with _blaming(f"{place(0)} and after"):
                found = jax.device_get(program(padded))
            parts.append(agreeing({name: array[: len(rows)] for name, array in found.items()}, stored, place))
        busy = time.perf_counter() - began
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}, busy


def _place(numbers: Numbers, index: int) -> str:
    return f"case {numbers[index]}"


@functools.lru_cache(maxsize=2)
def _batched(how: Together, key: ById) -> Any:
    """The compiled program of a study's batch."""

    def one(row: Any) -> dict[str, jax.Array]:
        return traced_arrays(outcome_of(key.study.run(key.study.insert(row))))

    return jax.jit(batched(one, how.devices))


def agreeing(
    found: dict[str, np.ndarray], stored: dict[str, Quantity], place: Callable[[int], str]
) -> dict[str, np.ndarray]:
    """Results in their stored types, without a change of any value.

    Args:
        found: results by name, (cases, ...) each.
        stored: types and shapes for one case, by name.
        place: from an index of the cases to words for it: ``case 7``, say.

    Raises:
        SweepError: if a result is missing, or has another type or shape; it names the case and the result.
    """
    if missing := [name for name in stored if name not in found]:
        raise SweepError(
            f"{place(0)}: the result {missing[0]} is missing, which the base has. Return it in every case: NaN, say."
        )
    if more := [name for name in found if name not in stored]:
        raise SweepError(
            f"{place(0)}: the result {more[0]} is new, and the base has none. Return it from the base too."
        )
    return {name: _agreeing(name, found[name], quantity, place) for name, quantity in stored.items()}


def _agreeing(name: str, array: np.ndarray, quantity: Quantity, place: Callable[[int], str]) -> np.ndarray:
    expected = np.dtype(quantity.dtype)
    shape = array.shape[1:]
    if shape != quantity.shape:
        raise SweepError(
            f"{place(0)}: {name} has the shape {shape}; expected {quantity.shape}, as from the base. All cases have "
            "the same shapes: fill up with NaN."
        )
    if array.dtype != expected:
        array = _cast(name, array, expected, place)
    if name == STATUS:
        wrong = np.flatnonzero((array < 0) | (array >= len(STATUS_NAMES)))
        if wrong.size:
            raise SweepError(
                f"{place(int(wrong[0]))}: {STATUS} is {array[wrong[0]]}; it must be a member of jaxscp.Status, 0 to "
                f"{len(STATUS_NAMES) - 1}."
            )
    return array


def _cast(name: str, array: np.ndarray, expected: np.dtype, place: Callable[[int], str]) -> np.ndarray:
    """Whole numbers become any number that equals them, and other numbers a type that holds all of theirs."""
    given, wrong = array.dtype, 0
    if given.kind in "iu" and expected.kind in "iuf":
        with np.errstate(over="ignore", invalid="ignore"):
            new = array.astype(expected)
            lost = ((new < 0) != (array < 0)) | (new.astype(given) != array) | ~np.isfinite(new)
        places = np.flatnonzero(lost.reshape(len(array), -1).any(axis=1))
        if places.size == 0:
            return new
        wrong = int(places[0])
    elif given.kind in "fc" and expected.kind in "fc" and np.can_cast(given, expected, "safe"):
        return array.astype(expected)
    value = f"{array[wrong]} " if array.ndim == 1 else ""
    hint = f"Return {_WORDS.get(given.kind, 'a number')} from the base too, or {expected} from every case."
    if name == SUCCESS:
        hint = "It must be True or False in every case."
    raise SweepError(
        f"{place(wrong)}: {name} is {value}({given}); expected {expected}, as from the base. {hint}"
    )
