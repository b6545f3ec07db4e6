"""Any ``OptimalControlProblem`` by CasADi and IPOPT, on the transcription of the default method.

Nodes, Runge-Kutta steps, points between the nodes, margins and the cost of an uneven mesh are the same. CasADi
differentiates, and IPOPT solves. Second-order cones are stated by a norm whose tip is rounded.

Not supported: parameters per node, soft constraints, constraints across intervals, and zero-order hold.
"""

import time
from collections.abc import Iterator
from typing import Any

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np

import jaxscp
from benchmarks.rivals.casadi_functions import casadi_function
from benchmarks.rivals.optimum import CONE_ROUNDING, SMOOTHING, Start, margin_of_rows, second_difference
from jaxscp.integration.tableaus import Method
from jaxscp.problem.canonical import canonical
from jaxscp.problem.end_conditions import end_condition, start_condition
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.problem.scaled_time import PathConstraint, ScaledTimeProblem
from jaxscp.transcription.shooting import METHOD, Grid

GRID = Grid()
NOISE = 0.2  # standard deviation of a random start, relative to the range of each variable in the guess, or to one


class AnyProblem:
    """The nonlinear program of a problem, and its first guess.

    Args:
        problem: whose numbers are concrete.
        guess: as the solver would take it.
        max_iterations: limit of IPOPT's iterations for each start.
    """

    def __init__(
        self,
        problem: jaxscp.OptimalControlProblem,
        guess: jaxscp.Trajectory,
        max_iterations: int = 3000,
    ) -> None:
        assert not problem.zero_order_hold
        guess = guess.resampled(problem.time.nodes)
        scaled = over_scaled_time(canonical(problem), jaxscp.NewtonSCP().form, guess)
        assert not scaled.cost.per_node
        assert not any(c.per_node or c.where.across or c.slack is not None for c in scaled.constraints)
        self.scaled = scaled
        self.guess = np.asarray(scaled.join(guess.state, guess.control, guess.dilation))
        options = {
            "print_time": False,
            "ipopt": {"print_level": 0, "sb": "yes", "max_iter": max_iterations, "tol": 1e-8},
        }
        program, self._equalities, self._mesh = self._program()
        self.solver = ca.nlpsol("problem", "ipopt", program, options)

    def solve(self, starts: int = 4, seed: int = 0) -> list[Start]:
        """Results from the guess, the first start, and from random perturbations of the guess.

        Costs are in the problem's units, without the cost of an uneven mesh.
        """
        random = np.random.default_rng(seed)
        lower, upper = np.full(self.guess.shape, -np.inf), np.full(self.guess.shape, np.inf)
        lower[:, -1], upper[:, -1] = self.scaled.dilation_min, self.scaled.dilation_max
        limits = np.where(np.arange(self.solver.size1_out("g")) < self._equalities, 0.0, np.inf)
        unit = 1.0 if self.scaled.sizes is None else float(self.scaled.sizes.cost)
        lines = []
        for start in range(starts):
            first = self.guess if start == 0 else self._perturbed(random)
            began = time.perf_counter()
            output: dict[str, Any] = self.solver(
                x0=first.ravel(), lbx=lower.ravel(), ubx=upper.ravel(), lbg=0.0, ubg=limits
            )
            statistics = self.solver.stats()
            cost = unit * (float(output["f"]) - float(self._mesh(output["x"])))
            seconds = time.perf_counter() - began
            lines.append(
                Start(cost, int(statistics["iter_count"]), seconds, str(statistics["return_status"]))
            )
        return lines

    def _perturbed(self, random: np.random.Generator) -> np.ndarray:
        ranges = np.ptp(self.guess, axis=0)
        moved = self.guess + NOISE * np.where(ranges > 0.0, ranges, 1.0) * random.standard_normal(
            self.guess.shape
        )
        moved[:, -1] = self.guess[:, -1] * np.exp(random.uniform(np.log(0.5), np.log(1.5)))
        return moved

    def _program(self) -> tuple[dict[str, Any], int, ca.Function]:
        p = self.scaled
        stacked = ca.MX.sym("Z", p.variables, p.nodes)
        n = p.state_size
        states, controls = stacked[:n, :], stacked[n:, :]
        ends, inner, effort = flow(p).map(p.nodes - 1)(states[:, :-1], controls[:, :-1], controls[:, 1:])
        initial = casadi_function(lambda x: start_condition(p, x), n)
        final = casadi_function(lambda x: end_condition(p, x), n)
        equalities = ca.vertcat(ca.vec(ends - states[:, 1:]), initial(states[:, 0]), final(states[:, -1]))
        inequalities = [row for c in p.constraints for row in self._held(c, stacked, inner)]
        dilation = controls[-1, :]
        duration = ca.sum2(dilation[:-1] + dilation[1:]) / (2.0 * (p.nodes - 1))
        mesh = 0.0 if p.mesh_weight is None else 0.5 * float(p.mesh_weight) * ca.sumsqr(ca.diff(dilation))
        cost = ca.sum2(effort) + terminal(p)(stacked[:, -1], duration) + mesh
        variables = ca.vec(stacked)
        program = {"x": variables, "f": cost, "g": ca.vertcat(equalities, *map(ca.vec, inequalities))}
        return program, equalities.numel(), ca.Function("mesh", [variables], [ca.MX(mesh)])

    def _held(self, c: PathConstraint, stacked: Any, inner: Any) -> Iterator[Any]:
        """Values of a constraint that must not be negative, at every place where it holds."""
        p, n = self.scaled, self.scaled.state_size
        value = casadi_function(lambda x, u: p.value_at(c, x, u, ()), n, p.variables - n)
        active = np.asarray(c.active)
        second_order = isinstance(c.cone, jaxscp.SecondOrder)
        if c.where.nodal:
            chosen = stacked[:, np.flatnonzero(active).tolist()]
            rows = value.map(chosen.size2())(chosen[:n, :], chosen[n:, :])
            yield cone_slack(rows) if second_order else rows
            return
        points, controls = GRID.subintervals + 1, stacked[n:, :]
        values = []
        for j in range(points):
            part = j / GRID.subintervals
            held = (1.0 - part) * controls[:, :-1] + part * controls[:, 1:]
            values.append(value.map(p.nodes - 1)(inner[:, j::points], held))
        for j, now in enumerate(values):
            mask = np.ones(p.nodes - 1)
            mask[0], mask[-1] = mask[0] * (j > 0), mask[-1] * (j < points - 1)
            margin = cone_margin if second_order else margin_of_rows
            tight = now - ca.repmat(ca.DM(mask).T, now.size1(), 1) * margin(second_difference(values, j))
            where = active[:-1].copy()
            where[-1] &= active[-1] or j < points - 1
            tight = tight[:, np.flatnonzero(where).tolist()]
            yield cone_slack(tight) if second_order else tight


def flow(p: ScaledTimeProblem) -> ca.Function:
    """Function: (x_i, u_i, u_{i+1}) to the end state, the states at all points (states, points), the running cost."""
    n, m = p.state_size, p.variables - p.state_size
    step = runge_kutta_step(p, METHOD, GRID.all_steps)
    x, first, last = ca.MX.sym("x", n), ca.MX.sym("u", m), ca.MX.sym("v", m)
    path = [ca.vertcat(x, 0.0)]
    for j in range(GRID.all_steps):
        path.append(step(path[-1], first, last, j / GRID.all_steps))
    points = ca.horzcat(*(y[:n] for y in path[:: GRID.steps]))
    return ca.Function("flow", [x, first, last], [path[-1][:n], points, path[-1][n]])


def runge_kutta_step(p: ScaledTimeProblem, method: Method, steps: int) -> ca.Function:
    """Function: (state and cost, controls at both ends of the interval, fraction at the step's begin) to its end."""
    n, m = p.state_size, p.variables - p.state_size
    slope = casadi_function(p.slope, n, m)
    y, first, last, begin = ca.SX.sym("y", n + 1), ca.SX.sym("u", m), ca.SX.sym("v", m), ca.SX.sym("begin")
    slopes: list[Any] = []
    for c, row in zip(method.c, method.a, strict=True):
        part = begin + c / steps
        moved = sum((a / steps * k for a, k in zip(row, slopes, strict=False) if a), y)
        slopes.append(slope(moved[:n], (1.0 - part) * first + part * last))
    end = sum((b / steps * k for b, k in zip(method.b, slopes, strict=True) if b), y)
    return ca.Function("step", [y, first, last, begin], [end])


def terminal(p: ScaledTimeProblem) -> ca.Function:
    """Function: (variables of the last node, final time in the solver's unit) to the terminal cost."""

    def value(v: jax.Array, duration: jax.Array) -> jax.Array:
        state, time, _, _ = p.split(v)
        if not p.carries_time:
            time = duration[0] if p.sizes is None else duration[0] * p.sizes.time
        cost = p.cost.terminal_at(state, time, ())
        return jnp.reshape(cost if p.sizes is None else cost / p.sizes.cost, (1,))

    return casadi_function(value, p.variables, 1)


def cone_margin(second: Any) -> Any:
    """Margin of a second-order cone: all of it is subtracted from the first row."""
    bound = np.sqrt(2.0) / 8.0 * (ca.sqrt(ca.sum1(second**2) + SMOOTHING**2) - SMOOTHING)
    return ca.vertcat(bound, ca.MX.zeros(second.size1() - 1, second.size2()))


def cone_slack(values: Any) -> Any:
    """t - |v|, with a rounded tip."""
    return values[0, :] - ca.sqrt(ca.sum1(values[1:, :] ** 2) + CONE_ROUNDING**2) + CONE_ROUNDING
