"""The solution of a problem. A planner from a file needs this module and its imports, and no solver."""

import os
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends.serving import Backends
from jaxscp.backends.xla import is_traced
from jaxscp.core import pytree_file
from jaxscp.core.status import StatusCode, status_names, status_text
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.problem.augmented import DYNAMICS, can_be_stored
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.time import limit_reached
from jaxscp.problem.trajectory import Trajectory
from jaxscp.scp.history import History
from jaxscp.solver.scenario import Advisor
from jaxscp.verification.certificate import Certificate
from jaxscp.verification.rollout import Rollout, rollout


class Solution(eqx.Module):
    """A planned trajectory with its checks: look at ``status`` first. ``print(solution)`` says what happened.

    Values are finite, but for the certificate of a trajectory that cannot be integrated.
    """

    status: StatusCode
    """``converged`` only if the iterations converged and the certificate passed."""
    trajectory: Trajectory
    cost: Scalar
    """Running and terminal cost of the problem."""
    final_time: Scalar
    """s"""
    iterations: Count
    """Subproblems solved."""
    interior_point_iterations: Count
    """Newton steps of the interior point, from the last subproblem's point to the optimum."""
    differentiable: Flag
    """Whether the solution is an optimum to rounding, so that it has derivatives; else requested ones are NaN."""
    multipliers: Multipliers | None
    """Of the dynamics, of the conditions at both ends and of the constraints; None for a method without them."""
    certificate: Certificate
    history: History
    """Of the iterations; ``iteration_table`` prints it."""
    backends: Backends
    """Implementations that served: JAX, compiled C++, or a CUDA kernel."""
    z: Float[Array, "nodes variables"]
    """Node variables, in the user's units; of a problem with a scale, relative to it."""
    context: Any
    """Data that the scenario built its problem with; of a landing, each interval's place (``landing.places``)."""
    fell_back: Flag
    """Whether a re-plan found nothing from the earlier plan, so that this one began at the scenario's own guess."""
    recovers: Flag
    """Whether the start lies outside of a wall, a zone or a limit, to which the first four intervals lead back: a
    measured start may, see ``LandingScenario.recovery``."""

    def save(self, file: str | os.PathLike, scenario: Any = None) -> None:
        """Write all of the solution to an .npz, and its scenario, for ``Solution.load``. No code is stored.

        The file has the name that you give: no suffix is added.

        Functions of yours cannot be stored: the problem of ``jaxscp.solve`` is not in the file, and dynamics of yours
        are left out of the trajectory.

        Args:
            file: to write.
            scenario: a ``LandingScenario``, say; ``LandingScenario.load`` reads it from the same file.

        Raises:
            TypeError: if the scenario or the context holds something else than arrays, numbers and texts.
            OSError: if the file cannot be written.

        Example:
            >>> import jaxscp, pathlib, tempfile
            >>> scenario = jaxscp.scenarios.ascent_to_platform()
            >>> solution = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=1))(scenario)
            >>> file = pathlib.Path(tempfile.mkdtemp()) / "plan.npz"
            >>> solution.save(file, scenario)
            >>> again, asked = jaxscp.Solution.load(file), jaxscp.LandingScenario.load(file)
            >>> bool(again.cost == solution.cost), asked.corridor.count
            (True, 3)
        """
        solution = self
        if not can_be_stored(self.trajectory.dynamics):
            bare = self.trajectory.with_dynamics(None)
            solution = eqx.tree_at(lambda s: s.trajectory, self, bare, is_leaf=lambda v: v is None)
        parts = {"solution": solution}
        pytree_file.write(file, parts if scenario is None else parts | {"scenario": scenario})

    @staticmethod
    def load(file: str | os.PathLike) -> "Solution":
        """The solution that ``save`` wrote, bitwise.

        Raises:
            ValueError: if the file is damaged, of a newer format, or holds no solution; the message names the field.
            OSError: if the file cannot be read.
        """
        found = pytree_file.read(file, "solution", CLASSES)
        if not isinstance(found, Solution):
            raise ValueError(f"{file}: holds no solution; Solution.save writes one")
        return found

    def rollout(self, problem: OptimalControlProblem, samples: int = 200) -> Rollout:
        """The controls integrated again from the start, without correction: the path that the certificate judges.

        Args:
            problem: that was solved; it gives the dynamics.
            samples: points an interval, two at least.

        Returns:
            ``time`` (intervals, samples) in s, ``state`` and ``control`` (intervals, samples, ...).

        Example:
            >>> import jaxscp
            >>> scenario = jaxscp.scenarios.ascent_to_platform()
            >>> solution = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=1))(scenario)
            >>> problem, _ = scenario.problem(10, context=solution.context)
            >>> solution.rollout(problem, samples=20).state.shape
            (9, 20, 13)
        """
        return rollout(problem, self.trajectory, samples)

    def iteration_table(self) -> str:
        """One line an iteration, then one for the interior point that found the optimum.

        ``|nu|`` is the largest virtual control, ``|dz|`` the largest change of a node; the interior point starts where
        the iterations ended, so the last ``|dz|`` need not be small.

        Raises:
            ValueError: for a batch; take an element of it first.
        """
        if np.ndim(self.cost) > 0:
            raise ValueError(
                "a batch has no table; take one element: jax.tree.map(lambda v: v[0], solutions)"
            )
        rows = [_HEADINGS, *(self._row(i) for i in range(int(self.iterations)))]
        if bool(self.differentiable):
            steps, defect = int(self.interior_point_iterations), float(self.certificate.defect)
            end = (
                f"{float(self.cost):.4f}",
                f"{float(self.final_time):.3f}",
                "",
                "",
                f"{defect:.1e}",
                str(steps),
            )
            rows.append(("optimum", *end))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join("  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in rows)

    def cause(self, scenario: Any = None) -> Any:
        """What holds a plan up that did not converge: the worst row of its certificate, and the largest multiplier.

        For a problem without a scale, also sizes that differ much. Empty for a converged plan, and for one without
        numbers. Of a batch, an array of texts, one an element.

        Args:
            scenario: that was planned, or the problem; of a batch, a stack of them. It tells of a final time at its
                limit, and of a deck that left the corridor.
        """
        if shape := np.shape(self.cost):
            host = jax.tree.map(np.asarray, (self, scenario))
            elements = (jax.tree.map(lambda v, i=i: v[i], host) for i in np.ndindex(shape))
            return np.array([element.cause(asked) for element, asked in elements], str).reshape(shape)
        if status_names(self.status) == "converged" or not np.isfinite(float(self.cost)):
            return ""
        claims_optimum = self.certificate.optimality is not None  # and else nothing between the nodes
        row, found = self.certificate.largest_row(claims_optimum), []
        if isinstance(scenario, OptimalControlProblem):
            found.append(limit_reached(scenario.time.final, float(self.final_time)))
        elif isinstance(scenario, Advisor):
            found.append(scenario.hindrance(self.trajectory))
        if row:
            found.append(f"largest violation: {row}")
        if self.multipliers is not None:
            # The last multipliers are of the dilation's limits.
            names = (*self.certificate.names[: len(self.multipliers.values) - 1], "limits of the final time")
            sizes = [float(np.max(np.abs(y), initial=0.0)) for y in self.multipliers.values]
            if len(names) == len(sizes) and max(sizes) > 0.0:
                found.append(f"largest multiplier: {names[int(np.argmax(sizes))]}")
        return "; ".join(text for text in [*found, *self._scaling()] if text)

    def _scaling(self) -> list[str]:
        """The advice to state a scale, where a problem has none and the sizes of its variables differ much."""
        path, states = self.trajectory, self.trajectory.state.shape[1]
        scaled = not np.array_equal(self.z[:, :states], path.state)
        if scaled or self.context is not None:  # a landing has its own scale
            return []
        values = {f"x[{i}]": v for i, v in enumerate(np.asarray(path.state).T)}
        values |= {f"u[{i}]": v for i, v in enumerate(np.asarray(path.control).T)}
        sizes = {name: float(np.max(np.abs(v))) for name, v in values.items()}
        sizes = {name: size for name, size in sizes.items() if size > _NOTHING}
        if not sizes or max(sizes.values()) <= _SIZES_DIFFER * min(sizes.values()):
            return []
        least, most = min(sizes, key=sizes.__getitem__), max(sizes, key=sizes.__getitem__)
        return [
            f"sizes differ much ({most} up to {sizes[most]:.3g}, {least} up to {sizes[least]:.3g}): give the problem "
            "typical sizes, scale=jaxscp.Scale(state=..., control=..., time=...)"
        ]

    def report(self, scenario: Any = None) -> str:
        """Status, its likely cause, cost, times, backends and certificate; of a batch, the counts of each status.

        Args:
            scenario: of one solution, as in ``cause``.
        """
        names, landing = status_names(self.status), self.context is not None
        if isinstance(names, str):
            text = status_text(names, landing)
            if names == "invalid_input":
                return f"{names}: no plan was made\n{text}"
            lines = [
                f"{names}: cost {float(self.cost):.6g}, final time {float(self.final_time):.6g}",
                text,
                *([cause] if (cause := self.cause(scenario)) else []),
                *(["planned anew: no plan was found from the earlier one"] if bool(self.fell_back) else []),
                *([_NEAR_OPTIMUM] if self._is_near_optimum() else []),
                *(["starts outside of a wall or a limit, and comes back"] if bool(self.recovers) else []),
                f"{int(self.iterations)} iterations, {int(self.interior_point_iterations)} steps of the interior point",
                self.backends.report(),
                self.certificate.report(),
            ]
            return "\n".join(lines)
        found, counts = np.unique(names, return_counts=True)
        lines = [
            f"{count} {name}{_elements(names, name)}: {status_text(name, landing)}"
            for name, count in zip(found, counts, strict=True)
        ]
        return "\n".join(
            [f"{names.size} solutions", *lines, self.backends.report(), self.certificate.report()]
        )

    def _is_near_optimum(self) -> bool:
        """Whether it converged to the method's tolerances alone, though the method looks for an optimum."""
        converged = status_names(self.status) == "converged"
        return converged and self.certificate.optimality is not None and not bool(self.differentiable)

    def __str__(self) -> str:
        return repr(self) if is_traced(self) or not _is_filled(self) else self.report()

    def _repr_pretty_(self, printer, cycle: bool) -> None:
        """The text that a notebook shows."""
        printer.text(str(self))

    def _row(self, index: int) -> tuple[str, ...]:
        h = self.history
        numbers = f"{h.cost[index]:.4f}", f"{h.final_time[index]:.3f}", f"{h.virtual_control[index]:.1e}"
        moved = f"{h.step_norm[index]:.1e}", f"{h.defect[index]:.1e}", str(int(h.conic_iterations[index]))
        return (str(index + 1), *numbers, *moved)


CLASSES = Solution, Trajectory, Multipliers, Certificate, History, Backends, *DYNAMICS
"""Classes of a solution's pytree: files name them."""

_NOTHING = 1e-3  # size of a variable that counts as none: it may be what rounding leaves of zero
_SIZES_DIFFER = 1e3
_LISTED = 3  # elements that a report names

_NEAR_OPTIMUM = "near an optimum, within the tolerances, but not at it to rounding: there are no derivatives"

_HEADINGS = "iteration", "cost", "final time", "|nu|", "|dz|", "defect", "Newton steps"


def _elements(names: np.ndarray, name: str) -> str:
    """The first elements of a batch that have a status, in words; empty for converged ones."""
    where = [", ".join(map(str, index)) for index in np.argwhere(names == name)]
    numbers = ("; " if names.ndim > 1 else ", ").join(where[:_LISTED]) + (
        ", ..." if len(where) > _LISTED else ""
    )
    return "" if name == "converged" else f" (element{'s' if len(where) > 1 else ''} {numbers})"


def _is_filled(solution: Solution) -> bool:
    """Whether every leaf is an array: transformations also make solutions of shapes, axes or flags."""
    leaves = jax.tree.leaves(solution)
    return bool(leaves) and all(isinstance(leaf, jax.Array | np.ndarray) for leaf in leaves)
