"""Conic programs from real runs: iterations, initial guesses, and subproblems made infeasible on purpose."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxscp import PTR, NormTrustRegion, ProximalTrustRegion, scenarios
from jaxscp.conic import StagedProgram
from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.landing.allocation import allocate
from jaxscp.landing.guess import Units, guess_program, guess_time, initial_guess
from jaxscp.landing.problem import landing_problem
from jaxscp.landing.scenario import LandingScenario
from jaxscp.problem.form import Paper
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.scp.nodal_subproblem import nodal_subproblem

NODES = 30
MISSIONS = {"platform": scenarios.platform_to_platform, "ascend": scenarios.ascent_to_platform}
MODES = {"paper": NormTrustRegion(), "proximal": ProximalTrustRegion()}
SCENARIOS, ITERATIONS = 12, 5

INTERIOR_POINT = jax.jit(InteriorPoint().__call__)


@dataclass(frozen=True)
class Subproblem:
    """A program and its origin."""

    mission: str
    mode: str
    """``paper``, ``proximal``, ``guess`` or ``infeasible``."""
    label: str
    program: StagedProgram


def subproblems(count: int = SCENARIOS, seed: int = 0) -> Iterator[Subproblem]:
    """Programs from ``count`` runs of each mission in each mode; the first run is the stored mission."""
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
    """Scenario with random start, goal and mass inside the same corridor."""
    width = np.array([0.3, 0.3, 0.1])
    offsets = [jnp.asarray(random.uniform(-width, width) + np.array([0.0, 0.0, 0.1])) for _ in range(2)]
    return eqx.tree_at(
        lambda s: (s.start.position, s.goal.position, s.airframe.body.mass),
        scenario,
        (
            scenario.start.position + offsets[0],
            scenario.goal.position + offsets[1],
            scenario.airframe.body.mass * random.uniform(0.8, 1.25),
        ),
    )


@jax.jit
def _prepared(scenario: LandingScenario):
    """(problem, conic program of the guess, guess)."""
    allocation = allocate(scenario.route(), NODES)
    problem = over_scaled_time(landing_problem(scenario, allocation, Paper()), Paper())
    guess = initial_guess(scenario, allocation)
    z = problem.join(guess.states, guess.controls, guess.dilation)
    units = Units.of(scenario, allocation, guess_time(scenario, allocation))
    return problem, guess_program(scenario, allocation, units), z


@cache
def _steps(mode: str):
    """Compiled parts (init, linearise, advance) of an iteration. The conic solution is an argument of ``advance``."""
    method = PTR(trust_region=MODES[mode])

    @jax.jit
    def linearise(problem, state):
        return nodal_subproblem(problem, state.z, state.flow, method.trust_region, method.virtual_weight)[0]

    @jax.jit
    def advance(problem, state, solution):
        solved = PTR(trust_region=MODES[mode], conic=lambda *_: solution)
        return solved.step(problem, state)

    return jax.jit(method.init), linearise, advance


def _iterations(
    mission: str, mode: str, run: int, problem: ScaledTimeProblem, z: jax.Array
) -> Iterator[Subproblem]:
    """Subproblems of the first iterations of a run."""
    init, linearise, advance = _steps(mode)
    state = init(problem, z)
    for iteration in range(ITERATIONS):
        program = linearise(problem, state)
        yield Subproblem(mission, mode, f"{run}.{iteration}", program)
        state = advance(problem, state, INTERIOR_POINT(program))
        if bool(state.done):
            return


def _infeasible(mission: str, run: int, problem: ScaledTimeProblem, z: jax.Array) -> Iterator[Subproblem]:
    """First subproblem of a run with one contradiction, large or small, among its hard constraints."""
    init, linearise, _ = _steps("paper")
    for gap in (1.0, 1e-2):
        for cause, broken in _contradictions(problem, gap).items():
            program = linearise(broken, init(broken, z))
            yield Subproblem(mission, "infeasible", f"{run} {cause} by {gap:g}", program)


def _contradictions(problem: ScaledTimeProblem, gap: float) -> dict[str, ScaledTimeProblem]:
    """Problems with contradictory constraints, by their cause."""
    middle = problem.nodes // 2
    faces = problem.constraints[0].parameters
    inside = -faces.offsets[0, 3] - problem.boundary.initial.parameters.value[0]
    return {
        "start outside": eqx.tree_at(
            lambda p: p.boundary.initial.parameters.value,
            problem,
            replace_fn=lambda v: v.at[0].add(inside - gap),
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
