"""The results of a sweep: tables, single cases, and the way to statistics."""

import os
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from jaxscp.core.status import STATUS_NAMES
from jaxscp.monte_carlo.errors import InvalidStudy, SweepError, extra
from jaxscp.monte_carlo.identity import unknown
from jaxscp.monte_carlo.intervals import Interval
from jaxscp.monte_carlo.outcome import STATUS, TRAJECTORY
from jaxscp.monte_carlo.stopping import Ending
from jaxscp.monte_carlo.storage import DATA, ENDING, STORED, Layout, Store
from jaxscp.monte_carlo.study import Study
from jaxscp.problem.trajectory import Trajectory


class Sweep:
    """The stored results of a sweep; ``sweep`` and ``open_sweep`` make it.

    Args:
        store: its folder.
        study: that was run; None if it is not at hand.
    """

    def __init__(self, store: Store, study: Study | None = None):
        stored = store.configuration()
        if stored is None:
            raise SweepError(f"{store.address}: holds no sweep.")
        self.store, self.study, self.layout = store, study, Layout.of(stored)
        self.independent = stored["study"]["sampling"].get("independent") is True
        """Whether cases are independent, so that intervals hold."""
        self.ending = _ending(store, self.layout.count)
        """Where the sweep ended, and why; None if it has not."""
        done = [i for i in store.done() if i < self.layout.chunks]
        cases = [np.arange(self.layout.cases(i).start, self.layout.cases(i).stop) for i in done]
        numbers = np.concatenate([np.zeros(0, int), *cases])
        if self.ending is not None:
            numbers = numbers[numbers < self.ending.cases]
            if len(numbers) < self.ending.cases:
                raise SweepError(
                    f"{store.address}: {self.ending.cases - len(numbers)} of {self.ending.cases} cases are missing: "
                    "they have no marker in done. Run the same sweep again: it computes them anew."
                )
        self.numbers: Int[np.ndarray, "cases"] = numbers
        """Cases of the tables."""

    @property
    def complete(self) -> int:
        """Number of cases of the tables."""
        return len(self.numbers)

    @property
    def parameters(self) -> list[str]:
        """Names of the parameters."""
        return list(self.layout.parameters)

    @property
    def results(self) -> list[str]:
        """Names of the numbers that each case results in."""
        return [name for name, quantity in self.layout.quantities.items() if not quantity.trajectory]

    def dataset(self, trajectories: bool = False) -> Any:
        """Parameters and results as an ``xarray.Dataset`` over ``case``, with units.

        Args:
            trajectories: whether to add those that are stored; of other cases they are NaN.
        """
        xarray = extra("xarray")
        found = xarray.open_zarr(
            f"{self.store.address}/{DATA}",
            chunks=None,
            consolidated=False,
            decode_times=False,
            decode_timedelta=False,  # a time in seconds stays a number
        )
        if not trajectories:
            found = found[[*self.parameters, *self.results, *([STORED] if STORED in found else [])]]
        found = found.assign_coords(case=np.arange(self.layout.count)).isel(case=self.numbers)
        if STATUS in found and "flag_meanings" in found[STATUS].attrs:
            names = np.array(STATUS_NAMES, dtype=str)[found[STATUS].values]
            found[STATUS] = ("case", names)
        return found.load()

    def to_pandas(self) -> Any:
        """Parameters and results as a ``pandas.DataFrame``, a row a case."""
        return self.dataset().to_dataframe()

    def to_parquet(self, file: str | os.PathLike) -> None:
        """Write the table of ``to_pandas`` to a Parquet file."""
        extra("pyarrow")
        self.to_pandas().to_parquet(file)

    def values(self, name: str) -> np.ndarray:
        """One parameter or result of all cases of the tables.

        Raises:
            SweepError: if there is no such name.
        """
        if name not in (known := [*self.parameters, *self.results]):
            raise SweepError(f"no parameter or result is called {name!r}; there are {', '.join(known)}.")
        return np.asarray(self.store.arrays[name][:])[self.numbers]

    def trajectory(self, number: int) -> Any:
        """The stored trajectory of a case: a ``Trajectory`` if it is one, else arrays by name.

        Raises:
            SweepError: if it is not stored; ``rerun`` computes it.
        """
        names = [name for name, quantity in self.layout.quantities.items() if quantity.trajectory]
        if not names or number not in self.numbers or not bool(self.store.arrays[STORED][number]):
            raise SweepError(
                f"case {number}: its trajectory is not stored; rerun(sweep, {number}) computes it again."
            )
        arrays = {name.partition(".")[2]: np.asarray(self.store.arrays[name][number]) for name in names}
        if set(arrays) == set(TRAJECTORY):
            time, state, control, dilation = (jnp.asarray(arrays[name]) for name in TRAJECTORY)
            return Trajectory(time, state, control, dilation)
        return arrays

    def with_trajectories(self) -> Int[np.ndarray, "stored"]:
        """Cases whose trajectories are stored."""
        if STORED not in self.store.arrays:
            return np.zeros(0, int)
        return self.numbers[np.asarray(self.store.arrays[STORED][:])[self.numbers]]

    def case(self, number: int) -> Any:
        """What case ``number`` ran on.

        Raises:
            InvalidStudy: if the sweep was opened without its study.
        """
        return study_of(self).case(number)

    def __repr__(self) -> str:
        return f"Sweep({self.store.address!r}, {self.complete} of {self.layout.count} cases)"


def study_of(sweep: Sweep | Study) -> Study:
    """The study of a sweep, or the study itself.

    Raises:
        InvalidStudy: if the sweep was opened without its study.
    """
    study = sweep if isinstance(sweep, Study) else sweep.study
    if study is None:
        raise InvalidStudy("the sweep was opened without its study; open_sweep(address, study) takes it.")
    return study


def known_identity(study: Study) -> dict[str, Any]:
    """The study as plain data.

    Raises:
        InvalidStudy: if an object has no content to compare, and the study no version.
    """
    identity = study.identity()
    if not study.version and (found := next(unknown(identity), None)):
        raise InvalidStudy(
            f"{found[0]}: this object ({found[1]}) has no content to compare, so that a changed study would go "
            "unnoticed. Give the study a version=, and another one whenever the object changes."
        )
    return identity


def stored_cases(store: Store) -> int:
    """Number of stored cases; zero of a damaged folder."""
    try:
        return Sweep(store).complete
    except SweepError:
        return 0


def _ending(store: Store, count: int) -> Ending | None:
    if not store.has(ENDING):
        return None
    stored = store.read(ENDING)
    try:
        interval = stored["interval"] and Interval(*map(float, stored["interval"]))
        found = Ending(int(stored["cases"]), str(stored["reason"]), interval, str(stored["of"]))
    except (KeyError, TypeError, ValueError):
        found = None
    if found is None or not 0 <= found.cases <= count:
        raise SweepError(
            f"{store.address}: {ENDING} is damaged. Run the same sweep again: it writes it anew."
        )
    return found


def open_sweep(address: str | os.PathLike, study: Study | None = None) -> Sweep:
    """The results in a folder; every finished chunk is checked.

    Args:
        address: of the folder.
        study: that was run, for ``rerun`` and ``case``.

    Raises:
        SweepError: if there is no sweep, it is another study's, or a chunk is damaged.
    """
    found = Sweep(Store(address), study)
    store, layout = found.store, found.layout
    if study is not None:
        store.check(store.configuration() or {}, study.identity())
    store.check_arrays(layout)
    damaged = [i for i in store.done() if i < layout.chunks and store.facts(i, layout.cases(i)) is None]
    if damaged:
        raise SweepError(
            f"{store.address}: the values of {len(damaged)} chunks do not agree with their checksums (chunk "
            f"{damaged[0]}, cases {layout.cases(damaged[0]).start} to {layout.cases(damaged[0]).stop - 1}, say). "
            "Run the same sweep again: it computes them anew."
        )
    return found
