"""How two saved pytrees differ, leaf by leaf."""

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class Leaf(NamedTuple):
    """A leaf that is not bitwise the same."""

    name: str
    """In the new tree."""
    absolute: float
    """Largest difference of two numbers."""
    relative: float
    """That over the largest number of the old leaf, or over one if that is larger."""
    exact: bool
    """Whether only equal numbers are the same: integers and flags."""


class Difference(NamedTuple):
    """Two trees."""

    item: str
    leaves: int
    """Pairs of leaves that were compared."""
    unequal: list[Leaf]
    unmatched: list[str]
    """Leaves of one tree that have no counterpart."""
    note: str = ""

    def passes(self, tolerance: float) -> bool:
        """Whether all is bitwise equal, or floats are equal within a relative tolerance."""
        if tolerance == 0.0:
            return not self.unmatched and not self.unequal  # even zeros of other sign differ
        within = (not leaf.exact and leaf.relative <= tolerance for leaf in self.unequal)
        return not self.unmatched and all(within)

    def report(self) -> str:
        """A line for people."""
        note = f" ({self.note})" if self.note else ""
        unmatched = f"; without counterpart: {', '.join(self.unmatched)}" if self.unmatched else ""
        if not self.unequal:
            return f"bitwise equal, {self.leaves} leaves{note}{unmatched}"
        most, relative = (max(self.unequal, key=lambda leaf: leaf[k]) for k in (1, 2))
        fields = dict.fromkeys(_field(leaf.name) for leaf in self.unequal)
        return (
            f"{len(self.unequal)} of {self.leaves} leaves differ: by {most.absolute:.2g} in {most.name}, "
            f"relative {relative.relative:.2g} in {relative.name}; in {', '.join(fields)}{note}{unmatched}"
        )

    def as_json(self) -> dict[str, Any]:
        """The same for programs."""
        return self._asdict() | {"unequal": [leaf._asdict() for leaf in self.unequal]}


def compare(item: str, old: Path, new: Path, note: str = "") -> Difference:
    """Compare two files of the worker.

    Leaves are paired by their names where both trees have the same names, else in flattening order if their numbers
    agree. Otherwise those are paired whose names agree.
    """
    a, b = (dict(np.load(file)) for file in (old, new))
    renamed = set(a) != set(b) and len(a) == len(b)
    pairs = list(zip(a, b, strict=True)) if renamed else [(name, name) for name in b if name in a]
    unmatched = [] if renamed else sorted(set(a) ^ set(b))
    infinite = sum(not np.all(np.isfinite(leaf)) for leaf in b.values())
    if infinite:
        note = f"{note}, not finite: {infinite}".lstrip(", ")
    leaves = [_leaf(name, a[before], b[name]) for before, name in pairs]
    return Difference(item, len(pairs), [leaf for leaf in leaves if leaf is not None], unmatched, note)


def _leaf(name: str, a: np.ndarray, b: np.ndarray) -> Leaf | None:
    """None where both are bitwise the same."""
    if a.shape != b.shape or a.dtype != b.dtype:
        return Leaf(f"{name} (shape or type)", np.inf, np.inf, exact=True)
    if a.tobytes() == b.tobytes():
        return None
    exact = not np.issubdtype(a.dtype, np.floating)
    a, b = a.astype(float), b.astype(float)
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore"):
        change = np.where(same, 0.0, np.abs(a - b))
    change = np.where(np.isnan(change), np.inf, change)
    largest = float(np.max(np.abs(a), initial=1.0, where=np.isfinite(a)))
    return Leaf(name, float(change.max()), float(change.max()) / largest, exact)


def _field(name: str) -> str:
    """The first part of a leaf's name."""
    return next(part for part in re.split(r"[.\[\]'\"]+", name) if part)
