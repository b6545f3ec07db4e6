"""Accuracy of the interior point and of OSQP on subproblems of real runs, against CLARABEL.

The programs come from both missions with random starts, goals and masses: several iterations with both trust regions,
and the initial guesses. Others are made infeasible on purpose. Run ``python -m benchmarks.subproblems [--json]``; the
exit status is one if a solver misses its mark.
"""

# pyright: reportAttributeAccessIssue=false
# clarabel is a compiled module without stubs

import argparse
import json
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import clarabel
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.subproblem_programs import INTERIOR_POINT, MODES, SCENARIOS, Subproblem, subproblems
from jaxscp import status_names
from jaxscp.conic import OSQP, ConicSolution, StagedProgram, export
from jaxscp.conic.osqp import status_of
from jaxscp.conic.quadratic import QuadraticProgram

INTERIOR_POINT_MARK = 1e-6  # relative difference of optimal values
OSQP_MARK = 1e-3  # the same for the quadratic form; OSQP is an operator-splitting method
REFERENCE_TOLERANCE = 1e-9  # CLARABEL's, for gap and residuals
SOLVED = ("converged", "almost_converged")

osqp = OSQP()


@dataclass(frozen=True)
class Comparison:
    """Results of three solvers on one program; a relative difference is NaN if a value is missing."""

    mission: str
    mode: str
    label: str
    reference: str
    """CLARABEL's status on the conic form."""
    status: str
    iterations: int
    reference_iterations: int
    relative: float
    """Relative difference of our interior point's optimal value from CLARABEL's."""
    osqp_reference: str
    """CLARABEL's status on the quadratic form."""
    osqp_status: str
    osqp_iterations: int
    osqp_relative: float
    """Relative difference of OSQP's optimal value of the quadratic form from CLARABEL's."""

    @property
    def disagrees(self) -> bool:
        """Whether the interior point and CLARABEL differ about feasibility."""
        return (self.status in SOLVED) != (self.reference in SOLVED)

    @property
    def misses(self) -> bool:
        """Whether the interior point misses its mark."""
        return self.disagrees or self.relative > INTERIOR_POINT_MARK

    @property
    def osqp_misses(self) -> bool:
        """Whether OSQP misses its mark; an iteration limit is not a wrong result."""
        wrong = self.osqp_status in SOLVED and self.osqp_reference not in SOLVED
        wrong |= self.osqp_status == "infeasible" and self.osqp_reference != "infeasible"
        return wrong or (self.osqp_reference in SOLVED and not self.osqp_relative <= OSQP_MARK)


# --- comparison ---


def compare(subproblem: Subproblem) -> Comparison:
    """Comparison on one program: conic form by ours and CLARABEL, quadratic form by OSQP and CLARABEL."""
    program = subproblem.program
    ours: ConicSolution = INTERIOR_POINT(program)
    reference, value, steps = _clarabel_conic(program)
    form, splitting = osqp.solve_quadratic(program)
    osqp_reference, osqp_value, _ = _clarabel_quadratic(form)
    name = str(status_names(ours.status))
    return Comparison(
        mission=subproblem.mission,
        mode=subproblem.mode,
        label=subproblem.label,
        reference=reference,
        status=name,
        iterations=int(ours.iterations),
        reference_iterations=steps,
        relative=_relative(float(ours.objective), value) if name in SOLVED else np.nan,
        osqp_reference=osqp_reference,
        osqp_status=str(status_names(status_of(jnp.asarray(splitting.code)))),
        osqp_iterations=splitting.iterations,
        osqp_relative=_relative(splitting.objective, osqp_value) if osqp_reference in SOLVED else np.nan,
    )


def _clarabel_conic(program: StagedProgram) -> tuple[str, float, int]:
    p = export(program)
    cones = [clarabel.ZeroConeT(p.zero), clarabel.NonnegativeConeT(p.nonnegative)]
    cones += [clarabel.SecondOrderConeT(dimension) for dimension in p.second_order]
    return _clarabel(p.P, p.q, p.A, p.b, cones)


def _clarabel_quadratic(form: QuadraticProgram) -> tuple[str, float, int]:
    equalities = form.equalities.offset.size
    cones = [clarabel.ZeroConeT(equalities), clarabel.NonnegativeConeT(form.u.size - equalities)]
    status, value, steps = _clarabel(form.P, form.q, form.A, form.u, cones)
    return status, value + form.constant, steps


def _clarabel(P, q, A, b, cones) -> tuple[str, float, int]:
    """(status as in ``jaxscp.Status``, optimal value, iterations)."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = REFERENCE_TOLERANCE
    solution = clarabel.DefaultSolver(P, q, A, b, cones, settings).solve()
    names = {
        "Solved": "converged",
        "AlmostSolved": "almost_converged",
        "PrimalInfeasible": "infeasible",
        "AlmostPrimalInfeasible": "infeasible",
        "DualInfeasible": "unbounded",
        "AlmostDualInfeasible": "unbounded",
    }
    return names.get(str(solution.status), str(solution.status)), solution.obj_val, solution.iterations


def _relative(value: float, reference: float) -> float:
    return abs(value - reference) / max(1.0, abs(reference))


# --- report ---


def summary(comparisons: list[Comparison]) -> list[dict]:
    """One row of statistics for each mission and mode."""
    groups = dict.fromkeys((c.mission, c.mode) for c in comparisons)
    return [
        _row(mission, mode, [c for c in comparisons if (c.mission, c.mode) == (mission, mode)])
        for mission, mode in groups
    ]


def _row(mission: str, mode: str, group: list[Comparison]) -> dict:
    relative, osqp_relative = (
        np.array([getattr(c, name) for c in group]) for name in ("relative", "osqp_relative")
    )
    valid, osqp_valid = (np.isfinite(v) | np.isinf(v) for v in (relative, osqp_relative))
    return {
        "mission": mission,
        "mode": mode,
        "programs": len(group),
        "solved": sum(c.status in SOLVED for c in group),
        "reference_solved": sum(c.reference in SOLVED for c in group),
        "disagree": sum(c.disagrees for c in group),
        "worst": float(np.max(relative[valid], initial=0.0)),
        "fraction_within_mark": float(np.mean([not c.misses for c in group])),
        "steps": float(np.median([c.iterations for c in group])),
        "most_steps": max(c.iterations for c in group),
        "reference_steps": float(np.median([c.reference_iterations for c in group])),
        "osqp_worst": float(np.max(osqp_relative[osqp_valid], initial=0.0)),
        "osqp_fraction_within_mark": float(np.mean([not c.osqp_misses for c in group])),
        "osqp_fraction_solved": float(np.mean([c.osqp_status in SOLVED for c in group])),
        "osqp_steps": float(np.median([c.osqp_iterations for c in group])),
    }


def _table(rows: list[dict]) -> str:
    head = (
        "mission   mode        programs  solved  CLARABEL  disagree  worst     within 1e-6  steps (most)  CLARABEL"
        " | OSQP worst  within 1e-3  solved  steps"
    )
    lines = [
        f"{r['mission']:9} {r['mode']:10} {r['programs']:9d} {r['solved']:7d} {r['reference_solved']:9d} "
        f"{r['disagree']:9d}  {r['worst']:7.1e} {r['fraction_within_mark']:12.1%} {r['steps']:6.0f} "
        f"({r['most_steps']:4d}) {r['reference_steps']:9.0f} | {r['osqp_worst']:10.1e} "
        f"{r['osqp_fraction_within_mark']:12.1%} {r['osqp_fraction_solved']:7.0%} {r['osqp_steps']:6.0f}"
        for r in rows
    ]
    return "\n".join([head, *lines])


def _dump(folder: Path, subproblem: Subproblem) -> Path:
    """Write a program's arrays to a file in a folder; returns the file."""
    folder.mkdir(parents=True, exist_ok=True)
    label = subproblem.label.replace(" ", "-")
    file = folder / f"{subproblem.mission}-{subproblem.mode}-{label}.npz"
    leaves = jax.tree_util.tree_leaves_with_path(subproblem.program)
    arrays: dict[str, Any] = {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}
    np.savez(file, **arrays)
    return file


def main() -> int:
    """Run the comparison; returns the number of programs on which a solver misses its mark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one object for scripts instead of a table")
    parser.add_argument("--scenarios", type=int, default=SCENARIOS, help="runs of each mission and mode")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--dump", type=Path, help="folder for the programs on which a mark is missed")
    arguments = parser.parse_args()
    began = time.perf_counter()
    comparisons, missed = [], []
    for subproblem in subproblems(arguments.scenarios, arguments.seed):
        comparison = compare(subproblem)
        comparisons.append(comparison)
        if comparison.misses or comparison.osqp_misses:
            missed.append(comparison)
            if arguments.dump:
                _dump(arguments.dump, subproblem)
    rows, seconds = summary(comparisons), time.perf_counter() - began
    if arguments.json:
        report = {"seconds": seconds, "rows": rows, "comparisons": [asdict(c) for c in comparisons]}
        print(json.dumps(report))
    else:
        print(_table(rows))
        taken = sum(c.mode in MODES for c in comparisons)
        print(f"{taken} subproblems of real runs, {len(missed)} programs miss a mark, {seconds:.0f} s")
        for c in missed:
            print(f"  {c}")
    return len(missed)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    sys.exit(min(main(), 1))
