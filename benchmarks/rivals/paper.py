"""The published stack: CVXPY with disciplined parameters, CLARABEL, and a Numba-compiled discretisation.

Algorithm 1 with subproblem (19). Virtual control acts on the physical states. The unsquared Euclidean norms of
virtual control and of the step from the reference are penalised. The step includes elapsed effort phi and time t, the
extended state. ``elapsed_in_trust=False`` leaves these two out.

Run ``python -m benchmarks.rivals.paper`` for a table of the three-box problem.
"""

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import clarabel  # noqa: F401  (fail here, not in the middle of a measurement, when it is missing)
import cvxpy as cp
import numpy as np

from benchmarks.rivals.flow import Discretisation, discretise, elapsed_along
from benchmarks.rivals.problem import (
    STATES,
    Floats,
    LandingArrays,
    extended_controls,
    fly,
    three_box,
    worst_cone_gap,
    worst_defect,
    worst_escape,
)

# the convex subproblem, equation (19)


@dataclass(eq=False)
class Subproblem:
    """One compiled shape: variables, the parameters that change between iterations, and the CVXPY problem."""

    problem: cp.Problem
    states: cp.Variable
    extended: cp.Variable
    elapsed: cp.Variable
    virtual: cp.Variable
    parameters: dict[str, cp.Parameter]
    dynamics: list[cp.Parameter]


@dataclass(frozen=True, eq=False)
class Iterate:
    """A reference trajectory or a subproblem's minimiser."""

    states: Floats
    """(N, 13)."""
    extended: Floats
    """(N, m + 1): thrusts and dilation."""
    elapsed: Floats
    """(N, 2): elapsed effort phi and time t."""

    def stacked(self) -> Floats:
        """The rows z_k, (N, 13 + m + 1 + 2); phi and t come last, so that they can be cut off."""
        return np.column_stack([self.states, self.extended, self.elapsed])


@lru_cache(maxsize=8)
def _subproblem(
    nodes: int, rotors: int, faces: int, cone_nodes: tuple[int, ...], elapsed_in_trust: bool
) -> Subproblem:
    """Subproblem (19) for a shape; every number is a parameter."""
    states = cp.Variable((nodes, STATES), name="states")
    extended = cp.Variable((nodes, rotors + 1), name="extended")
    elapsed = cp.Variable((nodes, 2), name="elapsed")
    virtual = cp.Variable((nodes - 1, STATES), name="virtual")
    virtual_norm = cp.Variable(nodes - 1, name="zeta")
    step_norm = cp.Variable(nodes, name="xi")
    parameters: dict[str, cp.Parameter] = {}

    def given(name: str, *shape: int, **signs: bool) -> cp.Parameter:
        return parameters.setdefault(name, cp.Parameter(shape, name=name, **signs))

    dynamics = [cp.Parameter((STATES, STATES + 2 * (rotors + 1))) for _ in range(nodes - 1)]
    flown = [
        matrix @ cp.hstack([states[i], extended[i], extended[i + 1]]) for i, matrix in enumerate(dynamics)
    ]
    efforts = cp.sum(
        cp.multiply(given("effort_now", nodes - 1, rotors + 1), extended[:-1])
        + cp.multiply(given("effort_next", nodes - 1, rotors + 1), extended[1:]),
        axis=1,
    )
    moved = cp.hstack([states, extended, elapsed] if elapsed_in_trust else [states, extended])
    constraints = [
        states[1:] == cp.vstack(flown) + given("offset", nodes - 1, STATES) + virtual,
        cp.norm(virtual, axis=1) <= virtual_norm,
        elapsed[0] == 0.0,
        elapsed[1:, 0] == elapsed[:-1, 0] + efforts + given("effort_offset", nodes - 1),
        elapsed[1:, 1] == elapsed[:-1, 1] + (extended[:-1, -1] + extended[1:, -1]) / (2 * (nodes - 1)),
        cp.norm(moved - given("reference", *moved.shape), axis=1) <= step_norm,
        states[0] == given("start", STATES),
        states[-1] == given("goal", STATES),
        extended >= given("lower", nodes, rotors + 1),
        extended <= given("upper", nodes, rotors + 1),
        *path_constraints(states[:, :3], faces, cone_nodes, given),
    ]
    objective = (
        given("weight_control", nonneg=True) * elapsed[-1, 0]
        + given("weight_time", nonneg=True) * elapsed[-1, 1]
        + given("weight_virtual", nonneg=True) * cp.sum(virtual_norm)
        + given("weight_trust", nonneg=True) * cp.sum(step_norm)
    )
    problem = cp.Problem(cp.Minimize(objective), constraints)
    return Subproblem(problem, states, extended, elapsed, virtual, parameters, dynamics)


def path_constraints(
    positions: Any, faces: int, cone_nodes: tuple[int, ...], given: Callable[..., cp.Parameter]
) -> list[cp.Constraint]:
    """Corridor (20) at every node of positions (N, 3), and landing cone (21)-(22) at the active ones."""
    nodes = positions.shape[0]
    along = sum(
        cp.multiply(given(f"normals_{axis}", nodes, faces), positions[:, [axis]] @ np.ones((1, faces)))
        for axis in range(3)
    )
    constraints: list[cp.Constraint] = [along <= given("offsets", nodes, faces)]
    if cone_nodes:
        chosen = positions[list(cone_nodes)]
        sideways = chosen[:, :2] - given("apex_sideways", len(cone_nodes), 2)
        # cotangent * apex height is one parameter: a product of two would not be a disciplined one
        upward = given("cotangent", nonneg=True) * chosen[:, 2] - given("apex_up")
        constraints.append(cp.norm(sideways, axis=1) <= upward)
    return constraints


def set_path(problem: LandingArrays, parameters: dict[str, cp.Parameter]) -> None:
    """Set the parameters of ``path_constraints``."""
    for axis in range(3):
        parameters[f"normals_{axis}"].value = problem.normals[:, :, axis]
    parameters["offsets"].value = problem.offsets
    if problem.cone_active.any():
        count = len(_cone_nodes(problem))
        parameters["apex_sideways"].value = np.tile(problem.cone_apex[:2], (count, 1))
        parameters["cotangent"].value = problem.cone_cotangent
        parameters["apex_up"].value = problem.cone_cotangent * problem.cone_apex[2]


def _set_problem(subproblem: Subproblem, problem: LandingArrays) -> None:
    """Set the parameters that are constant during one run of Algorithm 1."""
    parameters = subproblem.parameters
    set_path(problem, parameters)
    parameters["start"].value = problem.start
    parameters["goal"].value = problem.goal
    bounds = ((problem.thrust_min, problem.dilation_min), (problem.thrust_max, problem.dilation_max))
    for name, (thrust, dilation) in zip(("lower", "upper"), bounds, strict=True):
        parameters[name].value = np.tile(np.append(thrust, dilation), (problem.nodes, 1))
    for name in ("weight_control", "weight_time", "weight_virtual", "weight_trust"):
        parameters[name].value = getattr(problem, name)


def _set_reference(subproblem: Subproblem, reference: Iterate, model: Discretisation) -> None:
    """Set the parameters that each iteration of Algorithm 1 changes."""
    matrices = np.concatenate([model.state, model.control_now, model.control_next], axis=2)
    for parameter, matrix in zip(subproblem.dynamics, matrices, strict=True):
        parameter.value = matrix
    parameters, extended = subproblem.parameters, reference.extended
    parameters["offset"].value = model.offset
    parameters["effort_now"].value = model.effort_now
    parameters["effort_next"].value = model.effort_next
    linear = np.sum(model.effort_now * extended[:-1] + model.effort_next * extended[1:], axis=1)
    parameters["effort_offset"].value = model.effort - linear
    parameters["reference"].value = reference.stacked()[:, : parameters["reference"].shape[1]]


def _solve_compiled(problem: cp.Problem) -> tuple[float, float]:
    """Solve with CLARABEL; seconds inside CVXPY and inside CLARABEL. Raises if there is no solution."""
    began = time.perf_counter()
    data, chain, inverse = problem.get_problem_data(cp.CLARABEL, solver_opts={})
    handed_over = time.perf_counter()
    assert chain is not None
    raw = chain.solve_via_data(problem, data)
    solved = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the flag ``accurate`` records an inaccurate solution
        problem.unpack_results(raw, chain, inverse)
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise RuntimeError(f"CLARABEL reports {problem.status}")
    done = time.perf_counter()
    return (handed_over - began) + (done - solved), solved - handed_over


def _value(variable: cp.Variable) -> Floats:
    """Value of a variable after a successful solve."""
    return np.array(variable.value, dtype=np.float64)


# Algorithm 1


@dataclass(frozen=True)
class PaperIteration:
    """Figures of one iteration of Algorithm 1; costs are from the linearised subproblem."""

    objective: float
    """Cost and both penalties."""
    cost: float
    """w_u phi_N + w_t t_N."""
    final_time: float
    """Seconds."""
    virtual: float
    """Largest |nu_i|."""
    step: float
    """Largest |z_k - zref_k|."""
    discretise_seconds: float
    setup_seconds: float
    """Seconds in CVXPY: parameter values, the program's data, reading the solution."""
    solver_seconds: float
    """Seconds in CLARABEL."""
    accurate: bool
    """Whether CLARABEL met its full tolerances, not only the reduced ones."""


@dataclass(frozen=True, eq=False)
class PaperRun:
    """A run of Algorithm 1."""

    iterations: list[PaperIteration]
    compile_seconds: float
    """Seconds to prepare the first subproblem; compiles Numba and CVXPY if the shape is new."""
    states: Floats
    controls: Floats
    dilation: Floats
    converged: bool
    history: list[Iterate] = field(repr=False)
    """Every iterate, the guess first."""

    @property
    def seconds(self) -> float:
        """Seconds in the loop, without compilation."""
        return sum(r.discretise_seconds + r.setup_seconds + r.solver_seconds for r in self.iterations)


def solve(problem: LandingArrays, elapsed_in_trust: bool = True) -> PaperRun:
    """Run Algorithm 1 from the guess in the problem.

    Args:
        problem: the problem.
        elapsed_in_trust: whether z_k holds phi and t beside the state, the thrusts and the dilation.
    """
    subproblem, compile_seconds = _prepare(problem, elapsed_in_trust)
    extended = extended_controls(problem)
    reference = Iterate(problem.states, extended, elapsed_along(problem, extended))
    records, history = [], [reference]
    converged = False
    while not converged and len(records) < problem.max_iterations:
        reference, record = _iterate(problem, subproblem, reference)
        records.append(record)
        history.append(reference)
        converged = record.virtual < problem.tolerance_virtual and record.step < problem.tolerance_trust
    return PaperRun(
        iterations=records,
        compile_seconds=compile_seconds,
        states=reference.states,
        controls=reference.extended[:, :-1],
        dilation=reference.extended[:, -1],
        converged=converged,
        history=history,
    )


def _prepare(problem: LandingArrays, elapsed_in_trust: bool) -> tuple[Subproblem, float]:
    """The subproblem of this shape with the parameters of this problem, and the seconds of compilation."""
    began = time.perf_counter()
    extended = extended_controls(problem)
    model = discretise(problem, problem.states, extended)  # the first call compiles
    reference = Iterate(problem.states, extended, elapsed_along(problem, extended))
    subproblem = _subproblem(
        problem.nodes, problem.rotors, problem.offsets.shape[1], _cone_nodes(problem), elapsed_in_trust
    )
    _set_problem(subproblem, problem)
    _set_reference(subproblem, reference, model)
    subproblem.problem.get_problem_data(cp.CLARABEL)  # canonicalises a new shape
    return subproblem, time.perf_counter() - began


def _iterate(
    problem: LandingArrays, subproblem: Subproblem, reference: Iterate
) -> tuple[Iterate, PaperIteration]:
    """One iteration of Algorithm 1: discretise about the reference and solve subproblem (19)."""
    began = time.perf_counter()
    model = discretise(problem, reference.states, reference.extended)
    discretised = time.perf_counter()
    _set_reference(subproblem, reference, model)
    set_seconds = time.perf_counter() - discretised
    cvxpy_seconds, solver_seconds = _solve_compiled(subproblem.problem)

    found = Iterate(_value(subproblem.states), _value(subproblem.extended), _value(subproblem.elapsed))
    counted = subproblem.parameters["reference"].shape[1]
    step = (found.stacked() - reference.stacked())[:, :counted]
    effort, final_time = found.elapsed[-1]
    return found, PaperIteration(
        objective=float(subproblem.problem.objective.value),  # pyright: ignore[reportArgumentType]
        cost=float(problem.weight_control * effort + problem.weight_time * final_time),
        final_time=float(final_time),
        virtual=float(np.linalg.norm(_value(subproblem.virtual), axis=1).max()),
        step=float(np.linalg.norm(step, axis=1).max()),
        discretise_seconds=discretised - began,
        setup_seconds=set_seconds + cvxpy_seconds,
        solver_seconds=solver_seconds,
        accurate=subproblem.problem.status == cp.OPTIMAL,
    )


def _cone_nodes(problem: LandingArrays) -> tuple[int, ...]:
    return tuple(int(node) for node in np.flatnonzero(problem.cone_active))


# the initial guess, equations (25)-(26)


@dataclass(frozen=True, eq=False)
class DoubleIntegratorGuess:
    """A point mass through the corridor at a fixed final time."""

    positions: Floats
    """(N, 3)."""
    velocities: Floats
    """(N, 3)."""
    accelerations: Floats
    """(N, 3), net of gravity."""
    solve_seconds: float
    """Seconds in CLARABEL."""
    setup_seconds: float
    """Seconds in CVXPY, without compilation."""
    compile_seconds: float
    """Seconds of compilation; near zero after the first solve of a shape."""


@lru_cache(maxsize=8)
def _guess_program(
    nodes: int, faces: int, cone_nodes: tuple[int, ...]
) -> tuple[cp.Problem, tuple[cp.Variable, cp.Variable, cp.Variable], dict[str, cp.Parameter]]:
    """Program (26) for a shape; p'' = a with first-order hold on a, integrated exactly."""
    p, v, a = (cp.Variable((nodes, 3), name=name) for name in "pva")
    parameters: dict[str, cp.Parameter] = {}

    def given(name: str, *shape: int, **signs: bool) -> cp.Parameter:
        return parameters.setdefault(name, cp.Parameter(shape, name=name, **signs))

    h, h_squared = given("h", nonneg=True), given("h_squared", nonneg=True)
    constraints = [
        p[1:] == p[:-1] + h * v[:-1] + h_squared * (a[:-1] / 3 + a[1:] / 6),
        v[1:] == v[:-1] + h * (a[:-1] + a[1:]) / 2,
        *(p[k] == given(f"position_{k}", 3) for k in (0, nodes - 1)),
        *(v[k] == given(f"velocity_{k}", 3) for k in (0, nodes - 1)),
        *path_constraints(p, faces, cone_nodes, given),
    ]
    problem = cp.Problem(cp.Minimize(cp.sum(cp.norm(a, axis=1))), constraints)
    return problem, (p, v, a), parameters


def double_integrator_guess(problem: LandingArrays, final_time: float) -> DoubleIntegratorGuess:
    """Minimise the sum of |a_k| at a fixed final time in seconds, in the corridor and the landing cone."""
    began = time.perf_counter()
    program, variables, parameters = _guess_program(
        problem.nodes, problem.offsets.shape[1], _cone_nodes(problem)
    )
    stated = time.perf_counter() - began
    set_path(problem, parameters)
    parameters["h"].value = final_time * problem.interval
    parameters["h_squared"].value = (final_time * problem.interval) ** 2
    for k, state in ((0, problem.start), (problem.nodes - 1, problem.goal)):
        parameters[f"position_{k}"].value = state[0:3]
        parameters[f"velocity_{k}"].value = state[3:6]
    began = time.perf_counter()
    program.get_problem_data(cp.CLARABEL)  # compiles if this shape is new
    compile_seconds = stated + time.perf_counter() - began
    setup_seconds, solve_seconds = _solve_compiled(program)
    p, v, a = (_value(variable) for variable in variables)
    return DoubleIntegratorGuess(p, v, a, solve_seconds, setup_seconds, compile_seconds)


def main() -> None:
    """Print a short table of the three-box problem."""
    problem = three_box()
    print(
        "w_tr  w_t  subproblems  converged    cost   t_f s  escape m  defect"
        "  ms each: discretise  CVXPY  CLARABEL"
    )
    for weight_trust, weight_time in ((10.0, 0.0), (10.0, 5.0), (0.1, 0.0)):
        asked = replace(problem, weight_trust=weight_trust, weight_time=weight_time)
        solve(asked)  # compiles
        run = solve(asked)
        last = run.iterations[-1]
        flown = fly(problem, run.states, run.controls, run.dilation)
        discretising, setting_up, solving = (
            1e3 * np.median([getattr(record, name) for record in run.iterations])
            for name in ("discretise_seconds", "setup_seconds", "solver_seconds")
        )
        print(
            f"{weight_trust:4.1f} {weight_time:4.1f} {len(run.iterations):12d}  {run.converged!s:>9} "
            f"{last.cost:7.3f} {last.final_time:7.3f} {worst_escape(problem, flown[:, :, :3]):9.3f} "
            f"{worst_defect(problem, run.states, flown):7.0e} "
            f"{discretising:20.1f} {setting_up:6.1f} {solving:9.1f}"
        )
    double_integrator_guess(problem, 6.0)
    guess = double_integrator_guess(problem, 6.0)
    cone_gap = worst_cone_gap(problem, guess.positions[problem.cone_active])
    print(
        f"guess (26) at 6 s: {1e3 * guess.solve_seconds:.1f} ms in CLARABEL, "
        f"{1e3 * guess.setup_seconds:.1f} ms in CVXPY, worst cone gap {cone_gap:.0e} m"
    )


if __name__ == "__main__":
    main()
