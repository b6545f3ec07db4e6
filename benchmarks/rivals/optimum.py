"""The optimum of the default method's problem, by CasADi and IPOPT.

Nodes, points between the nodes, and margins are the same. Integration takes ten fourth-order steps an interval; jaxscp
takes five of sixth order. Only the statement of the problem comes from jaxscp.

Corridor, landing cone and keep-out ball hold at equally spaced points of every interval, with a margin for the values
between these points. The deck may move.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.rivals.ipopt import attitude_error, perturbed, runge_kutta_step
from benchmarks.rivals.problem import STATES, Floats, LandingArrays, extended_controls

SUBSTEPS, SUBINTERVALS = 10, 5  # Runge-Kutta steps, and subintervals between the points, an interval
SMOOTHING = 1e-4  # m; smooths max(0, d) in the margin
RESERVE = 1.1  # factor on the margin
CONE_ROUNDING = 1e-6  # m; smooths the cone's tip


@dataclass(frozen=True)
class Extras:
    """Features of a scenario that ``LandingArrays`` lacks."""

    deck_velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the deck, m/s."""
    ball: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre of the keep-out ball, m."""
    ball_radius: float = -100.0
    """Radius of the keep-out ball, m; negative: no ball."""


@dataclass(frozen=True)
class Start:
    """Result of IPOPT for one starting point."""

    cost: float
    iterations: int
    seconds: float
    status: str


def _flow(problem: LandingArrays) -> ca.Function:
    """Function: (x[i], v[i], v[i+1]) to the end state, positions (3, SUBINTERVALS + 1) and the effort."""
    step = runge_kutta_step(problem, SUBSTEPS)
    x, first, last = ca.MX.sym("x", STATES), *(ca.MX.sym(n, problem.rotors + 1) for n in "vw")
    held = [(1 - j / SUBSTEPS) * first + j / SUBSTEPS * last for j in range(SUBSTEPS + 1)]
    path = [ca.vertcat(x, 0.0)]
    for j in range(SUBSTEPS):
        path.append(step(path[-1], held[j], held[j + 1]))
    positions = ca.horzcat(*(y[:3] for y in path[:: SUBSTEPS // SUBINTERVALS]))
    return ca.Function("flow", [x, first, last], [path[-1][:STATES], positions, path[-1][STATES]])


class Optimum:
    """The nonlinear program of one instance.

    Args:
        problem: the problem; its penalty weights are not used.
        extras: features that the arrays lack.
        max_iterations: limit of IPOPT's iterations for each start.
    """

    def __init__(
        self, problem: LandingArrays, extras: Extras | None = None, max_iterations: int = 1000
    ) -> None:
        assert problem.substeps == SUBSTEPS
        self.problem, self.extras = problem, extras or Extras()
        began = time.perf_counter()
        program, self._equalities = self._program()
        options = {
            "print_time": False,
            "ipopt": {"print_level": 0, "sb": "yes", "max_iter": max_iterations},
        }
        self.solver = ca.nlpsol("landing", "ipopt", program, options)
        self.build_seconds = time.perf_counter() - began

    def _program(self) -> tuple[dict[str, Any], int]:
        problem, nodes = self.problem, self.problem.nodes
        stacked = ca.MX.sym("Z", STATES + problem.rotors + 1, nodes)
        states, held = stacked[:STATES, :], stacked[STATES:, :]
        ends, points, effort = _flow(problem).map(nodes - 1)(states[:, :-1], held[:, :-1], held[:, 1:])
        s0, s1 = held[-1, :-1], held[-1, 1:]
        elapsed = problem.interval * ca.cumsum((s0 + s1) / 2, 1)
        final_time = elapsed[-1]
        before = ca.horzcat(0.0, elapsed[:-1])

        goal, deck = ca.DM(problem.goal), ca.DM(self.extras.deck_velocity)
        equalities = ca.vertcat(
            ca.vec(ends - states[:, 1:]),
            states[:3, -1] - goal[:3] - deck * final_time,
            states[3:6, -1] - goal[3:6] - deck,
            attitude_error(states[6:10, -1], problem.goal[6:10]),
            states[10:13, -1] - goal[10:13],
        )
        at = [points[:, j :: SUBINTERVALS + 1] for j in range(SUBINTERVALS + 1)]  # (3, N - 1) each
        fractions = [j / SUBINTERVALS for j in range(SUBINTERVALS + 1)]
        times = [before + problem.interval * (s0 * a + (s1 - s0) * a**2 / 2) for a in fractions]
        inequalities = [*self._corridor(at), *self._cone(at, times), *self._ball(at)]
        cost = problem.weight_control * ca.sum2(effort) + problem.weight_time * final_time
        constraints = ca.vertcat(equalities, *map(ca.vec, inequalities))
        return {"x": ca.vec(stacked), "f": cost, "g": constraints}, equalities.numel()

    def _corridor(self, at: list[Any]) -> Iterator[Any]:
        normals, offsets = self.problem.normals[:-1], self.problem.offsets[:-1]
        for face in range(offsets.shape[1]):
            normal, offset = ca.DM(normals[:, face].T), ca.DM(offsets[:, face]).T
            yield from _with_margin([offset - ca.sum1(normal * x) for x in at])

    def _ball(self, at: list[Any]) -> Iterator[Any]:
        if self.extras.ball_radius > 0.0:
            centre = ca.DM(self.extras.ball)
            yield from _with_margin(
                [ca.sqrt(ca.sum1((x - centre) ** 2)) - self.extras.ball_radius for x in at]
            )

    def _cone(self, at: list[Any], times: list[Any]) -> Iterator[Any]:
        first = int(np.flatnonzero(self.problem.cone_active)[0])
        offsets = []
        for x, t in zip(at, times, strict=True):
            from_apex = x - ca.DM(self.problem.cone_apex) - ca.DM(self.extras.deck_velocity) @ t
            cone = ca.vertcat(self.problem.cone_cotangent * from_apex[2, :], from_apex[:2, :])
            offsets.append(cone[:, first:])
        for j, offset in enumerate(offsets):
            size = ca.sqrt(ca.sum1(second_difference(offsets, j) ** 2) + SMOOTHING**2) - SMOOTHING
            margin = size * np.sqrt(2.0) / 8.0
            if j == SUBINTERVALS:  # the last point of the trajectory is the apex
                offset, margin = offset[:, :-1], margin[:, :-1]
            sideways = ca.sqrt(ca.sum1(offset[1:, :] ** 2) + CONE_ROUNDING**2) - CONE_ROUNDING
            yield offset[0, :] - margin - sideways

    def solve(self, starts: int = 4, seed: int = 0) -> list[Start]:
        """Results from the guess, the first start, and from random perturbations of the guess."""
        problem, random = self.problem, np.random.default_rng(seed)
        guess = np.column_stack([problem.states, extended_controls(problem)])
        lower, upper = np.full(guess.shape, -np.inf), np.full(guess.shape, np.inf)
        lower[:, STATES:] = np.append(problem.thrust_min, problem.dilation_min)
        upper[:, STATES:] = np.append(problem.thrust_max, problem.dilation_max)
        lower[0, :STATES] = upper[0, :STATES] = problem.start
        lines = []
        for start in range(starts):
            began = time.perf_counter()
            first = guess if start == 0 else perturbed(guess, random)
            output: dict[str, Any] = self.solver(
                x0=first.ravel(), lbx=lower.ravel(), ubx=upper.ravel(), lbg=0.0, ubg=self._upper
            )
            statistics = self.solver.stats()
            lines.append(
                Start(
                    cost=float(output["f"]),
                    iterations=int(statistics["iter_count"]),
                    seconds=time.perf_counter() - began,
                    status=str(statistics["return_status"]),
                )
            )
        return lines

    @property
    def _upper(self) -> Floats:
        count = self.solver.size1_out("g")
        return np.where(np.arange(count) < self._equalities, 0.0, np.inf)


def best(lines: list[Start]) -> float:
    """Least cost of the starts that were solved; infinite if none was."""
    return min((line.cost for line in lines if line.status == "Solve_Succeeded"), default=np.inf)


def second_difference(values: list[Any], j: int) -> Any:
    """Second difference over three points times the reserve; extrapolated linearly at the end points."""
    last = len(values) - 1
    if j == 0:
        return 2 * second_difference(values, 1) - second_difference(values, 2)
    if j == last:
        return 2 * second_difference(values, last - 1) - second_difference(values, last - 2)
    return RESERVE * (values[j - 1] - 2 * values[j] + values[j + 1])


def margin_of_rows(second: Any) -> Any:
    """Margin for the values between the points, of each row: a chord errs by an eighth of the second difference."""
    return (second + ca.sqrt(second**2 + SMOOTHING**2) - SMOOTHING) / 16.0


def _with_margin(values: list[Any]) -> Iterator[Any]:
    """Values at each point less the margin, without the two fixed ends of the trajectory."""
    for j, value in enumerate(values):
        reduced = value - margin_of_rows(second_difference(values, j))
        if j == 0:
            reduced = reduced[:, 1:]
        yield reduced[:, :-1] if j == SUBINTERVALS else reduced
