"""The computation of one chunk of cases: draw, run, and write."""

import dataclasses
import time
from typing import Protocol, runtime_checkable

import numpy as np

from jaxscp.monte_carlo.outcome import SUCCESS, Quantity
from jaxscp.monte_carlo.sampling import Numbers, UnitPoints
from jaxscp.monte_carlo.storage import STORED, Layout, Store
from jaxscp.monte_carlo.study import Study
from jaxscp.monte_carlo.trajectories import Keep


@runtime_checkable
class Evaluator(Protocol):
    """Runs a study's cases in this process."""

    def quantities(self, study: Study) -> dict[str, Quantity]:
        """Results of a case, by name."""
        ...

    def evaluate(
        self, study: Study, numbers: Numbers, drawn: UnitPoints, stored: dict[str, Quantity]
    ) -> tuple[dict[str, np.ndarray], float]:
        """Results of some cases by name, (cases, ...) each, and seconds inside ``study.run``.

        Args:
            study: function and base.
            numbers: of the cases.
            drawn: their values of the parameters, ``study.values(numbers)``.
            stored: shapes and types of the results of a case, by name.
        """
        ...


@dataclasses.dataclass(frozen=True)
class ChunkReport:
    """A finished chunk."""

    index: int
    cases: int
    successes: int
    """Zero if the results have no success."""
    seconds: float
    """All of it."""
    busy: float
    """Inside ``study.run``."""


@dataclasses.dataclass(frozen=True)
class ChunkJob:
    """Computes chunks of a sweep, in any process."""

    study: Study
    evaluator: Evaluator
    store: Store
    layout: Layout
    keep: Keep
    resumed: bool
    """Whether an earlier call may have written parts of a chunk, and no marker."""

    def run(self, index: int) -> ChunkReport:
        """Compute and write a chunk."""
        began = time.perf_counter()
        cases = self.layout.cases(index)
        numbers = np.arange(cases.start, cases.stop)
        drawn = self.study.values(numbers)
        found, busy = self.evaluator.evaluate(self.study, numbers, drawn, self.layout.quantities)
        success = found.get(SUCCESS, np.zeros(len(numbers), bool)).astype(bool)
        values = {name: drawn[:, i] for i, name in enumerate(self.study.names)}
        values |= self._stored(found, numbers, success)
        fills = self._fills(values, len(numbers)) if self.resumed else {}
        self.store.write_values(cases.start, fills | values)
        report = ChunkReport(index, len(numbers), int(np.sum(success)), time.perf_counter() - began, busy)
        facts = {
            "cases": report.cases,
            "successes": report.successes,
            "seconds": report.seconds,
            "busy": busy,
        }
        self.store.write_marker(index, values, facts)
        return report

    def _stored(
        self, found: dict[str, np.ndarray], numbers: np.ndarray, success: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Results without trajectories if none is chosen."""
        paths = {name for name, quantity in self.layout.quantities.items() if quantity.trajectory}
        values = {name: array for name, array in found.items() if name not in paths}
        if not paths:
            return values
        chosen = self.keep.chosen(numbers, success)
        values[STORED] = chosen
        if np.any(chosen):
            for name in paths:
                rows = chosen.reshape(-1, *([1] * (found[name].ndim - 1)))
                values[name] = np.where(rows, found[name], self._fill(name))
        return values

    def _fills(self, values: dict[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
        """Fill values of the trajectories that are not stored."""
        missing = [(n, q) for n, q in self.layout.quantities.items() if n not in values]
        return {name: np.full((count, *q.shape), self._fill(name)) for name, q in missing}

    def _fill(self, name: str) -> np.ndarray:
        dtype = self.layout.quantities[name].dtype
        return np.asarray(np.nan if np.issubdtype(dtype, np.floating) else 0, dtype)
