"""The conic solvers on subproblems of real runs: our interior point and OSQP, both judged by CLARABEL.

Both missions, from random starts, goals and masses, several iterations each, with both trust regions; the
programs of their initial guesses; and programs made infeasible on purpose. Run
``python -m benchmarks.subproblems [--json]``; it ends with an error where a solver misses its mark.
"""

# pyright: reportAttributeAccessIssue=false
# clarabel is a compiled module without stubs

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import clarabel
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxscp import PTR, NormTrustRegion, ProximalTrustRegion, scenarios, status_names
from jaxscp.conic import OSQP, ConicSolution, StagedProgram, export
from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.osqp import status_of
from jaxscp.conic.quadratic import QuadraticProgram
from jaxscp.landing.allocation import allocate
from jaxscp.landing.guess import Units, guess_program, guess_time, initial_guess
from jaxscp.landing.problem import landing_problem
from jaxscp.landing.scenario import LandingScenario
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.scp.nodal_subproblem import convexify

NODES = 30
MISSIONS = {"platform": scenarios.platform_to_platform, "ascend": scenarios.ascent_to_platform}
MODES = {"paper": NormTrustRegion(), "proximal": ProximalTrustRegion()}
SCENARIOS, ITERATIONS = 12, 5

INTERIOR_POINT_MARK = 1e-6  # relative difference of optimal values
OSQP_MARK = 1e-3  # of the quadratic form's, whose solver is an operator-splitting method
REFERENCE_TOLERANCE = 1e-9  # of CLARABEL: gap and residuals
SOLVED = ("converged", "almost_converged")

interior_point = jax.jit(InteriorPoint().__call__)
osqp = OSQP()


@dataclass(frozen=True)
class Subproblem:
    """A program and where it comes from."""

    mission: str
    mode: str
    """``paper``, ``proximal``, ``guess`` or ``infeasible``."""
    label: str
    program: StagedProgram


@dataclass(frozen=True)
class Comparison:
    """What three solvers made of one program; relative differences are NaN where there is nothing to compare."""

    mission: str
    mode: str
    label: str
    reference: str
    """CLARABEL's status on the conic form."""
    status: str
    iterations: int
    reference_iterations: int
    relative: float
    """Our interior point's optimal value against CLARABEL's."""
    osqp_reference: str
    """CLARABEL's status on the quadratic form."""
    osqp_status: str
    osqp_iterations: int
    osqp_relative: float
    """OSQP's optimal value of the quadratic form against CLARABEL's."""

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
        """Whether OSQP misses its mark; running out of steps without an answer is no false one."""
        wrong = self.osqp_status in SOLVED and self.osqp_reference not in SOLVED
        wrong |= self.osqp_status == "infeasible" and self.osqp_reference != "infeasible"
        return wrong or (self.osqp_reference in SOLVED and not self.osqp_relative <= OSQP_MARK)


# --- subproblems of real runs ---


def subproblems(count: int = SCENARIOS, seed: int = 0) -> Iterator[Subproblem]:
    """Programs from ``count`` runs of each mission in each mode, the first run from the mission as stored."""
    random = np.random.default_rng(seed)
    for mission, make in MISSIONS.items():
        for run in range(count):
            scenario = _varied(make(), random) if run else make()
            problem, guess, z = _prepared(scenario)
            yield Subproblem(mission, "guess", f"{run}", guess)
            for mode in MODES:
                yield from _iterations(mission, mode, run, problem, z)
            if run < 2:
                yield from _infeasible(mission, run, problem, z)


def _varied(scenario: LandingScenario, random: np.random.Generator) -> LandingScenario:
    """Another start, goal and mass, inside the same corridor."""
    width = np.array([0.3, 0.3, 0.1])
    shift = [jnp.asarray(random.uniform(-width, width) + np.array([0.0, 0.0, 0.1])) for _ in range(2)]
    return eqx.tree_at(
        lambda s: (s.start.position, s.goal.position, s.airframe.body.mass),
        scenario,
        (
            scenario.start.position + shift[0],
            scenario.goal.position + shift[1],
            scenario.airframe.body.mass * random.uniform(0.8, 1.25),
        ),
    )


@jax.jit
def _prepared(scenario: LandingScenario):
    """Problem, program of the guess, and the guess."""
    allocation = allocate(scenario.corridor, scenario.start.position, scenario.goal.position, NODES)
    problem = landing_problem(scenario, allocation, published=True)
    guess = initial_guess(scenario, allocation)
    z = problem.join(guess.states, guess.controls, guess.dilation)
    units = Units.of(scenario, allocation, guess_time(scenario, allocation))
    return problem, guess_program(scenario, allocation, units), z


@cache
def _steps(mode: str):
    """Compiled parts of one iteration; the solution is an argument, so that no solver is compiled in."""
    method = PTR(trust_region=MODES[mode])

    @jax.jit
    def linearise(problem, state):
        return convexify(problem, state.z, state.flow, method.trust_region, method.virtual_weight)[0]

    @jax.jit
    def advance(problem, state, solution):
        given = PTR(trust_region=MODES[mode], conic=lambda *_: solution)
        return given.step(problem, state)

    return jax.jit(method.init), linearise, advance


def _iterations(
    mission: str, mode: str, run: int, problem: OptimalControlProblem, z: jax.Array
) -> Iterator[Subproblem]:
    init, linearise, advance = _steps(mode)
    state = init(problem, z)
    for iteration in range(ITERATIONS):
        program = linearise(problem, state)
        yield Subproblem(mission, mode, f"{run}.{iteration}", program)
        state = advance(problem, state, interior_point(program))
        if bool(state.done):
            return


def _infeasible(mission: str, run: int, problem: OptimalControlProblem, z: jax.Array) -> Iterator[Subproblem]:
    """The first subproblem with one contradiction, large or small, among its hard constraints."""
    init, linearise, _ = _steps("paper")
    for gap in (1.0, 1e-2):
        for cause, broken in _contradictions(problem, gap).items():
            program = linearise(broken, init(broken, z))
            yield Subproblem(mission, "infeasible", f"{run} {cause} by {gap:g}", program)


def _contradictions(problem: OptimalControlProblem, gap: float) -> dict[str, OptimalControlProblem]:
    middle = problem.nodes // 2
    faces = problem.constraints[0].parameters
    inside = -faces.offsets[0, 3] - problem.initial.parameters.value[0]
    return {
        "start outside": eqx.tree_at(
            lambda p: p.initial.parameters.value, problem, replace_fn=lambda v: v.at[0].add(inside - gap)
        ),
        "box without inside": eqx.tree_at(
            lambda p: p.constraints[0].parameters.offsets,
            problem,
            faces.offsets.at[middle, 0].set(-faces.offsets[middle, 3] - gap),
        ),
        "thrust limits reversed": eqx.tree_at(
            lambda p: p.constraints[1].parameters.lower,
            problem,
            problem.constraints[1].parameters.upper + gap,
        ),
        "dilation limits reversed": eqx.tree_at(
            lambda p: p.dilation_min, problem, problem.dilation_max + gap
        ),
    }


# --- comparison ---


def compare(subproblem: Subproblem) -> Comparison:
    """Solve one program four times: conic and quadratic form, ours and CLARABEL's."""
    program = subproblem.program
    ours: ConicSolution = interior_point(program)
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
    equalities = form.hard.offset.size
    cones = [clarabel.ZeroConeT(equalities), clarabel.NonnegativeConeT(form.u.size - equalities)]
    status, value, steps = _clarabel(form.P, form.q, form.A, form.u, cones)
    return status, value + form.constant, steps


def _clarabel(P, q, A, b, cones) -> tuple[str, float, int]:
    """Status in our words, optimal value, iterations."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = REFERENCE_TOLERANCE
    answer = clarabel.DefaultSolver(P, q, A, b, cones, settings).solve()
    words = {
        "Solved": "converged",
        "AlmostSolved": "almost_converged",
        "PrimalInfeasible": "infeasible",
        "AlmostPrimalInfeasible": "infeasible",
        "DualInfeasible": "unbounded",
        "AlmostDualInfeasible": "unbounded",
    }
    return words.get(str(answer.status), str(answer.status)), answer.obj_val, answer.iterations


def _relative(value: float, reference: float) -> float:
    return abs(value - reference) / max(1.0, abs(reference))


# --- report ---


def summary(comparisons: list[Comparison]) -> list[dict]:
    """One row for each mission and mode."""
    groups = dict.fromkeys((c.mission, c.mode) for c in comparisons)
    return [
        _row(mission, mode, [c for c in comparisons if (c.mission, c.mode) == (mission, mode)])
        for mission, mode in groups
    ]


def _row(mission: str, mode: str, group: list[Comparison]) -> dict:
    relative, osqp_relative = (
        np.array([getattr(c, name) for c in group]) for name in ("relative", "osqp_relative")
    )
    known, osqp_known = (np.isfinite(v) | np.isinf(v) for v in (relative, osqp_relative))
    return {
        "mission": mission,
        "mode": mode,
        "programs": len(group),
        "solved": sum(c.status in SOLVED for c in group),
        "reference_solved": sum(c.reference in SOLVED for c in group),
        "disagree": sum(c.disagrees for c in group),
        "worst": float(np.max(relative[known], initial=0.0)),
        "share_within_mark": float(np.mean([not c.misses for c in group])),
        "steps": float(np.median([c.iterations for c in group])),
        "most_steps": max(c.iterations for c in group),
        "reference_steps": float(np.median([c.reference_iterations for c in group])),
        "osqp_worst": float(np.max(osqp_relative[osqp_known], initial=0.0)),
        "osqp_share_within_mark": float(np.mean([not c.osqp_misses for c in group])),
        "osqp_share_solved": float(np.mean([c.osqp_status in SOLVED for c in group])),
        "osqp_steps": float(np.median([c.osqp_iterations for c in group])),
    }


def _table(rows: list[dict]) -> str:
    head = (
        "mission   mode        programs  solved  CLARABEL  disagree  worst     within 1e-6  steps (most)  CLARABEL"
        " | OSQP worst  within 1e-3  solved  steps"
    )
    lines = [
        f"{r['mission']:9} {r['mode']:10} {r['programs']:9d} {r['solved']:7d} {r['reference_solved']:9d} "
        f"{r['disagree']:9d}  {r['worst']:7.1e} {r['share_within_mark']:12.1%} {r['steps']:6.0f} "
        f"({r['most_steps']:4d}) {r['reference_steps']:9.0f} | {r['osqp_worst']:10.1e} "
        f"{r['osqp_share_within_mark']:12.1%} {r['osqp_share_solved']:7.0%} {r['osqp_steps']:6.0f}"
        for r in rows
    ]
    return "\n".join([head, *lines])


def _dump(folder: Path, subproblem: Subproblem) -> Path:
    """Write a program's arrays, for whoever looks into it."""
    folder.mkdir(parents=True, exist_ok=True)
    label = subproblem.label.replace(" ", "-")
    file = folder / f"{subproblem.mission}-{subproblem.mode}-{label}.npz"
    leaves = jax.tree_util.tree_leaves_with_path(subproblem.program)
    arrays: dict[str, Any] = {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}
    np.savez(file, **arrays)
    return file


def main() -> int:
    """Run the comparison; returns the number of programs on which a mark is missed."""
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
