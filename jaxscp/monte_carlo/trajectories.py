"""Which trajectories a sweep stores; numbers are stored of all cases."""

import dataclasses
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Int


@runtime_checkable
class Keep(Protocol):
    """A choice of cases by their numbers and their success."""

    def chosen(self, numbers: Int[np.ndarray, "cases"], success: Bool[np.ndarray, "cases"]) -> np.ndarray:
        """Whether to store the trajectory of each case."""
        ...


@dataclasses.dataclass(frozen=True)
class NoTrajectories:
    """Numbers alone."""

    def chosen(self, numbers: Int[np.ndarray, "cases"], success: Bool[np.ndarray, "cases"]) -> np.ndarray:
        """See ``Keep``."""
        return np.zeros(len(numbers), bool)


@dataclasses.dataclass(frozen=True)
class AllTrajectories:
    """Trajectories of every case."""

    def chosen(self, numbers: Int[np.ndarray, "cases"], success: Bool[np.ndarray, "cases"]) -> np.ndarray:
        """See ``Keep``."""
        return np.ones(len(numbers), bool)


@dataclasses.dataclass(frozen=True)
class FailedTrajectories:
    """Trajectories of cases without success, and of every n-th case if asked."""

    every: int = 0

    def chosen(self, numbers: Int[np.ndarray, "cases"], success: Bool[np.ndarray, "cases"]) -> np.ndarray:
        """See ``Keep``."""
        nth = numbers % self.every == 0 if self.every > 0 else np.zeros(len(numbers), bool)
        return ~success | nth


@dataclasses.dataclass(frozen=True)
class EveryNth:
    """Trajectories of cases 0, n, 2 n, ...

    Example:
        >>> import numpy as np
        >>> EveryNth(2).chosen(np.arange(4), np.ones(4, bool)).tolist()
        [True, False, True, False]
    """

    every: int

    def __post_init__(self):
        if self.every < 1:
            raise ValueError(f"EveryNth: every must be 1 or more, got {self.every}")

    def chosen(self, numbers: Int[np.ndarray, "cases"], success: Bool[np.ndarray, "cases"]) -> np.ndarray:
        """See ``Keep``."""
        return numbers % self.every == 0
