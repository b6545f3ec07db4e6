"""Profile of a solve: time of each part, number of calls, and operations relative to the machine's peak.

Each part is timed inside a compiled loop on the data of the first subproblem. Its time is multiplied by its number of
calls in the solve. The last row is the time of the whole solve less the sum of the parts: loops, tests of convergence,
choices.
"""

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.speed.arithmetic import flops, flops_of_loop
from benchmarks.speed.timing import Ceiling, Loop, ceiling, least_seconds
from jaxscp import PTR, LandingScenario, NewtonSCP, Planner
from jaxscp.cones import product
from jaxscp.conic import conic_form, kkt, native
from jaxscp.conic.equilibrate import equilibrate
from jaxscp.landing.scenarios import platform_to_platform
from jaxscp.landing.units import in_units, units_of
from jaxscp.landing.validation import validate
from jaxscp.linalg import riccati
from jaxscp.nlp.newton_system import (
    eliminate_inequalities,
    newton_matrix,
    scaled,
    scalings,
    second_order_model,
)
from jaxscp.problem.node_values import typical_sizes
from jaxscp.scp.active_set import active_set, slacks
from jaxscp.scp.hessian_convexification import LinearDynamics, convexified_along_horizon, projected
from jaxscp.scp.interval_subproblem import interval_program
from jaxscp.scp.nodal_subproblem import nodal_subproblem
from jaxscp.scp.second_order_correction import Target, corrected, correction
from jaxscp.solver.solution import Solution
from jaxscp.transcription.discretise import discretise
from jaxscp.transcription.gradient import gradient_by
from jaxscp.transcription.lagrangian import residual
from jaxscp.transcription.layout import stage_sizes, trajectory_of
from jaxscp.transcription.shooting import evaluate, linearise_with_hessian
from jaxscp.transcription.stationarity import stationarity
from jaxscp.verification.certificate import certify
from jaxscp.verification.integrator.method import eighth_order

Echo = Callable[[str], None]


@dataclass(frozen=True)
class Piece:
    """A part of a solve."""

    name: str
    times: float
    """Number of calls in a solve."""
    seconds: float
    """Time of one call, s."""
    flops: float
    """Operations of one call; NaN if not counted."""
    inside: bool = False
    """Whether this is a part of the last entry with ``inside=False``."""


def profile(planner: Planner, scenario: LandingScenario, machine: Ceiling, echo: Echo) -> dict[str, Any]:
    """Time a planner's parts on a scenario and print the times."""
    solution = planner(scenario)
    whole = least_seconds(lambda: planner(scenario))
    echo(
        f"{_describe(planner)}, {planner.nodes_for(scenario)} nodes: {1e3 * whole:.1f} ms a plan, "
        f"{int(solution.iterations)} subproblems, {_newton_steps(solution)} conic Newton steps, "
        f"{int(solution.interior_point_iterations)} interior steps"
    )
    echo(f"{'':38}{'times':>6}{'us each':>10}{'ms':>9}{'fraction':>10}{'kFLOP each':>12}{'of peak':>9}")
    pieces = Pieces(whole, machine, echo)
    _all_pieces(pieces, planner, scenario, solution)
    echo(_row(Piece("the rest", 1, pieces.rest, np.nan), whole, machine))
    return {
        "seconds": whole,
        "subproblems": int(solution.iterations),
        "conic_newton_steps": _newton_steps(solution),
        "interior_steps": int(solution.interior_point_iterations),
        "pieces": [dataclasses.asdict(p) for p in pieces.found],
        "rest_seconds": pieces.rest,
    }


def _describe(planner: Planner) -> str:
    return "paper's mode" if isinstance(planner.method, PTR) else "default mode"


def _newton_steps(solution: Solution) -> int:
    return int(np.sum(solution.history.conic_iterations))


def _row(p: Piece, whole: float, machine: Ceiling) -> str:
    name = f"    {p.name}" if p.inside else p.name
    total = p.times * p.seconds
    line = f"{name:38}{p.times:6.0f}{1e6 * p.seconds:10.1f}{1e3 * total:9.2f}{total / whole:10.0%}"
    if np.isnan(p.flops):
        return line
    return f"{line}{p.flops / 1e3:12.0f}{p.flops / p.seconds / machine.flops:9.1%}"


class Pieces:
    """Times parts of a solve and stores the times; each call returns the part's result."""

    def __init__(self, whole: float, machine: Ceiling, echo: Echo) -> None:
        self.found: list[Piece] = []
        self._whole, self._machine, self._echo = whole, machine, echo

    def add(self, piece: Piece) -> None:
        """Store and print."""
        self.found.append(piece)
        self._echo(_row(piece, self._whole, self._machine))

    def time(self, name: str, times: float, function: Callable, *args: Any, inside=False, count=True) -> Any:
        """Time a part on these arguments; returns its result."""
        loop = Loop(function, *args)
        arithmetic = flops(function, *args) if count else np.nan
        self.add(Piece(name, times, loop.seconds(*args), arithmetic, inside))
        return loop.result(*args)

    @property
    def rest(self) -> float:
        """Seconds of the whole solve less the sum of its parts."""
        return self._whole - sum(p.times * p.seconds for p in self.found if not p.inside)


def _all_pieces(pieces: Pieces, planner: Planner, scenario: LandingScenario, solution: Solution) -> None:
    request = least_seconds(lambda: validate(scenario, planner.nodes_for(scenario)))
    pieces.add(Piece("check of the request, in NumPy", 1, request, np.nan))
    problem, z, _ = pieces.time("guess and problem", 1, planner.pipeline.setup, scenario, count=False)
    if isinstance(planner.method, PTR):
        _paper_pieces(pieces, planner.method, problem, z, solution)
    else:
        assert isinstance(planner.method, NewtonSCP)
        _default_pieces(pieces, planner.method, problem, z, solution)
    trajectory = trajectory_of(problem, solution.z)
    pieces.time(
        "certificate", 1, lambda p, t: certify(p, t, planner.samples), problem, trajectory, count=False
    )


def _paper_pieces(pieces: Pieces, method: PTR, problem: Any, z: Any, solution: Solution) -> None:
    count = int(solution.iterations)
    flow = pieces.time("discretise", count + 1, lambda p, z: discretise(p, z, method.substeps), problem, z)

    def assemble(problem, z, flow):
        return nodal_subproblem(problem, z, flow, method.trust_region, method.virtual_weight)[0]

    program = pieces.time("assemble", count, assemble, problem, z, flow)
    _conic_pieces(pieces, method.conic, program, count, _newton_steps(solution))


def _conic_pieces(pieces: Pieces, conic: Any, program: Any, count: int, steps: int) -> None:
    """Equilibration and starting point; Newton steps and their parts."""
    start, whole = Loop(replace(conic, max_iterations=0), program), Loop(conic, program)
    started, taken = start.seconds(program), int(whole.result(program).iterations)
    step = (whole.seconds(program) - started) / taken
    pieces.add(Piece("conic: equilibrate, start, conclude", count, started, np.nan))
    pieces.add(
        Piece("conic: Newton step", steps, step, flops_of_loop(replace(conic, compiled=False), program))
    )
    if conic.compiled and native.supports(program):
        return  # the parts below belong to the loop in JAX

    scaled_program, _ = pieces.time(
        "equilibrate", count, lambda p: equilibrate(p, conic.equilibration), program, inside=True
    )
    unit = product.identity(conic_form.constraint_offset(scaled_program))
    scaling = product.scaling(unit, unit)

    def factorise(program, scaling):
        return kkt.factorise(program, scaling, conic.regularisation)

    def solve(program, scaling, factor, x, y):
        return kkt.solve(program, scaling, factor, x, y, conic.refinements)

    def solve_both(program, scaling, factor, x, y):
        return jax.vmap(lambda x, y: solve(program, scaling, factor, x, y))(x, y)

    inside = functools.partial(pieces.time, inside=True)
    factor = inside("factor", steps, factorise, scaled_program, scaling)
    right = (conic_form.linear_cost(scaled_program), conic_form.constraint_offset(scaled_program))
    two = jax.tree.map(lambda v: jnp.stack([v, 2.0 * v]), right)
    inside("back-solve of predictor, two sides", steps, solve_both, scaled_program, scaling, factor, *two)
    inside("back-solve of corrector", steps, solve, scaled_program, scaling, factor, *right)
    inside("step to the boundary", 2 * steps, product.longest_step, unit, right[1])


def _default_pieces(pieces: Pieces, method: NewtonSCP, problem: Any, z: Any, solution: Solution) -> None:
    count, grid = int(solution.iterations), method.grid
    y = solution.multipliers  # the guess has zero multipliers: its Hessian is too easy to convexify
    linear, curvature = pieces.time(
        "linearise, with Hessian",
        count + 1,
        lambda p, z, y: linearise_with_hessian(p, z, y, grid),
        problem,
        z,
        y,
    )
    scale = stage_sizes(problem, typical_sizes(z))
    hessian, n = curvature * scale * scale[:, None], problem.state_size
    convex = pieces.time("Hessian: project", count, projected, hessian)
    defect = residual(problem, z, linear.outputs).defect
    dynamics = LinearDynamics(linear.jacobian.end * scale / scale[:n, None], defect / scale[:n])
    times = _times_along_horizon(method, problem, z, count)
    final = jnp.eye(problem.variables)
    pieces.time(
        "Hessian: convexify along the horizon", times, convexified_along_horizon, hessian, dynamics, final
    )

    def assemble(problem, z, linear, hessian):
        return interval_program(
            problem, z, linear, hessian, jnp.zeros(hessian.shape[:2]), method.virtual_weight
        )

    blocks = jnp.pad(convex.hessian, ((0, 1), (0, 0), (0, 0))) + method.proximal * jnp.eye(scale.shape[0])
    blocks = blocks / scale / scale[:, None]
    program = pieces.time("assemble", count, assemble, problem, z, linear, blocks)
    _conic_pieces(pieces, method.conic, program, count, _newton_steps(solution))
    _line_search(pieces, method, problem, z, linear, y, convex.hessian, count)
    _interior_pieces(pieces, method, problem, solution)


def _times_along_horizon(method: NewtonSCP, problem: Any, z: Any, count: int) -> int:
    """Number of subproblems with a Hessian convexified along the horizon: the last ones."""
    state, step, times = jax.jit(method.init)(problem, z), jax.jit(method.step), 0
    for _ in range(count):
        times += bool(state.full_hessian)
        state = step(problem, state)
    return times


def _line_search(pieces: Pieces, method: NewtonSCP, problem, z, linear, y, metric, count: int) -> None:
    """Line search with whole steps: shorter steps are tried only if the whole step fails."""
    sizes, grid = typical_sizes(z), method.grid
    active = active_set(problem, linear, y, stage_sizes(problem, sizes))
    args = (problem, linear, active, metric, sizes)
    by = pieces.time("correction: factor", count, correction, *args)
    now = residual(problem, z, linear.outputs)
    target = Target(slacks(problem, linear.outputs), now.initial, now.final)
    rounds = method.correction_rounds

    def correct(problem, z, by, target):
        return corrected(problem, z, by, grid, rounds, target)

    pieces.time("correction: of a candidate", count, correct, problem, z, by, target)
    integrations = (rounds + 2) * count  # one integration each round, and the test of its gain
    pieces.time("integrations", integrations, lambda p, z: evaluate(p, z, grid), problem, z, inside=True)


def _interior_pieces(pieces: Pieces, method: NewtonSCP, problem: Any, solution: Solution) -> None:
    interior, grid, z, y = method.interior, method.grid, solution.z, solution.multipliers
    steps, sizes = int(solution.interior_point_iterations), typical_sizes(solution.z)
    start = jax.jit(lambda p, z, y: interior.init(p, z, y, grid))(problem, z, y)
    pieces.time("interior: Newton step", steps, lambda p, s: interior.step(p, s, grid, sizes), problem, start)
    inside = functools.partial(pieces.time, inside=True)
    model = inside(
        "second-order model", steps, lambda p, z, y: second_order_model(p, z, y, grid), problem, z, y
    )

    def matrix(problem, model, start):
        w = scalings(problem, start.slack, start.y.values)
        vectors = (start.y.values, start.slack, start.slack)
        eliminated = eliminate_inequalities(problem, model.jacobians, w, *vectors)
        return newton_matrix(problem, model, eliminated, sizes), eliminated.products

    lq_problem, _ = inside("matrix", steps, matrix, problem, model, start)
    factor = inside("factor", steps, riccati.factor, lq_problem)
    inside("back-solve", steps, riccati.solve, factor, scaled(model.residual, sizes))
    last, times = jax.jit(method.init)(problem, z), float(not solution.differentiable)
    pieces.time("restore dynamics", times, method.restore_dynamics, problem, last)

    def kkt_residual(problem, z, y, cost):
        return stationarity(gradient_by(eighth_order(), problem, z, y, grid), z, cost)

    pieces.time("KKT residual", 1, kkt_residual, problem, z, y, solution.cost)


def run(echo: Echo, nodes: int = 30) -> dict[str, Any]:
    """Profiles of both modes on Case 1."""
    scenario, machine = platform_to_platform(), ceiling()
    scenario = in_units(scenario, units_of(scenario))  # its solution is then in the units of the solver
    echo(machine.report())
    found: dict[str, Any] = {"peak_flops": machine.flops, "bandwidth": machine.bandwidth}
    for name, method in (("paper", PTR()), ("default", NewtonSCP())):
        found[name] = profile(Planner(nodes=nodes, method=method), scenario, machine, echo)
    return found
