"""The reference optimum: CasADi and IPOPT on the same transcription, without jaxscp's linearisation.

Multiple shooting on N nodes, Runge-Kutta in each interval, first-order hold on thrusts and dilation. Corridor
and cone hold at the nodes. With ``inner_points`` they also hold at that many equally spaced points inside each
interval. Then the half-spaces of node i belong to interval i as a whole: its inner points and its end obey them.
A node where the polytope changes therefore lies in both polytopes. The inner points of interval i obey the cone if
node i does.

The terminal attitude is fixed by three numbers, the vector part of the error quaternion. The flow keeps |q|, so
the other three would imply a fourth, and multipliers would not be unique.

Run ``python -m benchmarks.rivals.ipopt`` for a table of the three-box problem; ``--compiled`` compiles first.
"""

import argparse
import contextlib
import tempfile
import time
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.rivals.problem import (
    ATTITUDE,
    STATES,
    Flags,
    Floats,
    LandingArrays,
    extended_controls,
    fly,
    three_box,
    worst_defect,
    worst_escape,
)

CONE_ROUNDING = 1e-6  # metres

# dynamics


def state_rate(problem: LandingArrays, state: ca.SX, thrusts: ca.SX) -> ca.SX:
    """Time derivative (13,) of the rigid body's state."""
    velocity, w, vector, rate = state[3:6], state[6], state[7:10], state[10:13]
    force = ca.DM(problem.thrust_map / problem.mass) @ thrusts
    twist = ca.cross(vector, force)
    acceleration = force + 2 * w * twist + 2 * ca.cross(vector, twist) - ca.DM([0, 0, problem.gravity])
    torque = ca.DM(problem.torque_map) @ thrusts - ca.cross(rate, ca.DM(problem.inertia) @ rate)
    return ca.vertcat(
        velocity,
        acceleration,
        -0.5 * ca.dot(vector, rate),
        0.5 * (w * rate + ca.cross(vector, rate)),
        ca.DM(np.linalg.inv(problem.inertia)) @ torque,
    )


def runge_kutta_step(problem: LandingArrays, substeps: int) -> ca.Function:
    """Function: (state and effort, extended controls at both ends of the step) to state and effort at the end."""
    begin, now, following = ca.SX.sym("y", STATES + 1), *(ca.SX.sym(n, problem.rotors + 1) for n in "vw")
    h, middle = problem.interval / substeps, (now + following) / 2

    def rate(held: ca.SX, y: ca.SX) -> ca.SX:
        thrusts, dilation = held[:-1], held[-1]
        return dilation * ca.vertcat(state_rate(problem, y[:STATES], thrusts), ca.norm_2(thrusts))

    k1 = rate(now, begin)
    k2 = rate(middle, begin + h / 2 * k1)
    k3 = rate(middle, begin + h / 2 * k2)
    k4 = rate(following, begin + h * k3)
    return ca.Function("step", [begin, now, following], [begin + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])


def interval_flow(problem: LandingArrays, inner_points: int) -> ca.Function:
    """Function: (x[i], v[i], v[i+1]) to the end state, the inner positions (3, inner_points) and the effort.

    Steps are calls of one small function: an unrolled version cannot be compiled in reasonable time.
    """
    state, now, following = ca.MX.sym("x", STATES), *(ca.MX.sym(n, problem.rotors + 1) for n in "vw")
    each = -(-problem.substeps // (inner_points + 1))  # inner points lie at ends of steps
    substeps = each * (inner_points + 1)
    step = runge_kutta_step(problem, substeps)
    held = [(1 - j / substeps) * now + j / substeps * following for j in range(substeps + 1)]
    path = [ca.vertcat(state, 0.0)]
    for j in range(substeps):
        path.append(step(path[-1], held[j], held[j + 1]))
    inner = [y[:3] for y in path[each:-1:each]]
    positions = ca.horzcat(*inner) if inner else ca.MX(3, 0)
    return ca.Function("flow", [state, now, following], [path[-1][:STATES], positions, path[-1][STATES]])


# transcription


@dataclass(frozen=True, eq=False)
class Transcription:
    """The nonlinear program over Z (13 + m + 1, N), columns z_k = (x_k, u_k, s_k)."""

    solver: ca.Function
    lower: Floats
    upper: Floats
    constraint_lower: Floats
    constraint_upper: Floats
    build_seconds: float


class _Constraints:
    """Collects expressions and their bounds."""

    def __init__(self) -> None:
        self.expressions: list[ca.MX] = []
        self.lower: list[Floats] = []
        self.upper: list[Floats] = []

    def zero(self, expression: ca.MX) -> None:
        self._between(expression, 0.0, 0.0)

    def nonnegative(self, expression: ca.MX) -> None:
        self._between(expression, 0.0, np.inf)

    def _between(self, expression: ca.MX, lower: float, upper: float) -> None:
        flat = ca.vec(expression)
        self.expressions.append(flat)
        self.lower.append(np.full(flat.numel(), lower))
        self.upper.append(np.full(flat.numel(), upper))


def transcribe(
    problem: LandingArrays, inner_points: int = 0, max_iterations: int = 3000, compiled: bool = False
) -> Transcription:
    """The nonlinear program with its derivatives by CasADi; arguments as in ``solve``."""
    began = time.perf_counter()
    nodes, intervals = problem.nodes, problem.nodes - 1
    stacked = ca.MX.sym("Z", STATES + problem.rotors + 1, nodes)
    states, extended = stacked[:STATES, :], stacked[STATES:, :]
    flow = interval_flow(problem, inner_points).map(intervals)
    ends, inner, effort = flow(states[:, :-1], extended[:, :-1], extended[:, 1:])

    constraints = _Constraints()
    constraints.zero(ends - states[:, 1:])
    constraints.zero(attitude_error(states[ATTITUDE, -1], problem.goal[ATTITUDE]))
    hold_nodes(constraints, problem, states[:3, :], whole_intervals=inner_points > 0)
    for point in range(inner_points):
        positions = inner[:, point::inner_points]
        hold_corridor(constraints, positions, problem.normals[:-1], problem.offsets[:-1])
        hold_cone(constraints, problem, positions, problem.cone_active[:-1])

    duration = problem.interval * ca.sum2((extended[-1, :-1] + extended[-1, 1:]) / 2)
    cost = problem.weight_control * ca.sum2(effort) + problem.weight_time * duration
    program = {"x": ca.vec(stacked), "f": cost, "g": ca.vertcat(*constraints.expressions)}
    options: dict[str, Any] = {
        "print_time": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": max_iterations},
    }
    solver = (
        _compiled_solver(program, options) if compiled else ca.nlpsol("landing", "ipopt", program, options)
    )
    lower, upper = variable_bounds(problem)
    return Transcription(
        solver=solver,
        lower=lower,
        upper=upper,
        constraint_lower=np.concatenate(constraints.lower),
        constraint_upper=np.concatenate(constraints.upper),
        build_seconds=time.perf_counter() - began,
    )


def _compiled_solver(program: dict[str, ca.MX], options: dict[str, Any]) -> ca.Function:
    """The solver with compiled derivatives. CasADi writes C files into the working directory; the loaded code stays."""
    compiling = {
        "jit": True,
        "jit_cleanup": False,
        "compiler": "shell",
        "jit_options": {"flags": ["-O1"], "cleanup": False},
    }
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        return ca.nlpsol("landing", "ipopt", program, options | compiling)


def attitude_error(attitude: ca.MX, goal: Floats) -> ca.MX:
    """Vector part (3,) of conj(goal) * attitude."""
    scalar, vector = float(goal[0]), ca.DM(goal[1:])
    return scalar * attitude[1:] - attitude[0] * vector - ca.cross(vector, attitude[1:])


def hold_nodes(
    constraints: _Constraints, problem: LandingArrays, positions: ca.MX, whole_intervals: bool
) -> None:
    """Add the corridor and the cone at the nodes (3, N), except the first and the last, which are fixed.

    With ``whole_intervals``, node i + 1 also lies in the polytope of node i. Faces that both polytopes share are
    added once: a repeated constraint has no unique multiplier.
    """
    between = positions[:, 1:-1]
    hold_corridor(constraints, between, problem.normals[1:-1], problem.offsets[1:-1])
    hold_cone(constraints, problem, between, problem.cone_active[1:-1])
    if whole_intervals:
        faces = np.concatenate([problem.normals, problem.offsets[:, :, None]], axis=2)
        repeated = np.all(faces[:-2, :, None] == faces[1:-1, None, :], axis=3).any(axis=2)
        unseen = np.where(repeated[:, :, None], 0.0, problem.normals[:-2])
        hold_corridor(constraints, between, unseen, problem.offsets[:-2])


def hold_corridor(constraints: _Constraints, positions: ca.MX, normals: Floats, offsets: Floats) -> None:
    """Add polytopes (n, F, 3) and (n, F) at positions (3, n); faces with a zero normal do not count."""
    for face in range(offsets.shape[1]):
        used = np.flatnonzero(np.any(normals[:, face] != 0.0, axis=1))
        if used.size:
            along = ca.sum1(ca.DM(normals[used, face].T) * positions[:, used.tolist()])
            constraints.nonnegative(ca.DM(offsets[used, face]).T - along)


def hold_cone(constraints: _Constraints, problem: LandingArrays, positions: ca.MX, active: Flags) -> None:
    """Add the landing cone at the active (n,) positions (3, n)."""
    coned = np.flatnonzero(active).tolist()
    if coned:
        # The tip is rounded: smooth, and wider by CONE_ROUNDING at most. The gradient of the squared form vanishes
        # at the tip; IPOPT then needs many times the iterations.
        from_apex = positions[:, coned] - ca.DM(problem.cone_apex)
        sideways = ca.sqrt(ca.sum1(from_apex[:2, :] ** 2) + CONE_ROUNDING**2) - CONE_ROUNDING
        constraints.nonnegative(problem.cone_cotangent * from_apex[2, :] - sideways)


def variable_bounds(problem: LandingArrays) -> tuple[Floats, Floats]:
    """Bounds of vec(Z): thrusts and dilation everywhere, the start, and the goal except its attitude."""
    shape = (problem.nodes, STATES + problem.rotors + 1)
    lower, upper = np.full(shape, -np.inf), np.full(shape, np.inf)
    lower[:, STATES:] = np.append(problem.thrust_min, problem.dilation_min)
    upper[:, STATES:] = np.append(problem.thrust_max, problem.dilation_max)
    for bound in (lower, upper):
        free = bound[-1, ATTITUDE].copy()
        bound[0, :STATES], bound[-1, :STATES] = problem.start, problem.goal
        bound[-1, ATTITUDE] = free
    return lower.ravel(), upper.ravel()


# solving


@dataclass(frozen=True)
class IpoptStart:
    """Result of IPOPT for one starting point."""

    cost: float
    final_time: float
    """Seconds."""
    iterations: int
    seconds: float
    status: str


@dataclass(frozen=True, eq=False)
class IpoptRun:
    """The best solution over all starts, and the result of each start."""

    cost: float
    final_time: float
    """Seconds."""
    states: Floats
    controls: Floats
    dilation: Floats
    converged: bool
    """Whether any start was solved; if none was, the solution is from the last start."""
    starts: list[IpoptStart]
    build_seconds: float
    """Seconds for the transcription and its derivatives, once for all starts."""


def solve(
    problem: LandingArrays,
    inner_points: int = 0,
    starts: int = 4,
    seed: int = 0,
    max_iterations: int = 3000,
    compiled: bool = False,
) -> IpoptRun:
    """Minimise w_u phi + w_t t from the guess and from random perturbations of it.

    Args:
        problem: the problem; its penalty weights are not used.
        inner_points: number of points inside each interval at which corridor and cone hold.
        starts: number of starting points; the first is the guess.
        seed: seed of the perturbations.
        max_iterations: limit of IPOPT's iterations for each start.
        compiled: whether the system's C compiler compiles the derivatives. The compilation is slow, but each
            iteration is several times faster.
    """
    transcription = transcribe(problem, inner_points, max_iterations, compiled)
    random = np.random.default_rng(seed)
    guess = np.column_stack([problem.states, extended_controls(problem)])
    lines: list[IpoptStart] = []
    answers: list[Floats] = []
    for start in range(starts):
        columns, line = _solve_from(transcription, guess if start == 0 else perturbed(guess, random))
        lines.append(line)
        answers.append(columns)
    solved = [i for i, line in enumerate(lines) if line.status == "Solve_Succeeded"]
    best = min(solved, key=lambda i: lines[i].cost) if solved else starts - 1
    columns = answers[best]
    return IpoptRun(
        cost=lines[best].cost,
        final_time=lines[best].final_time,
        states=columns[:, :STATES],
        controls=columns[:, STATES:-1],
        dilation=columns[:, -1],
        converged=bool(solved),
        starts=lines,
        build_seconds=transcription.build_seconds,
    )


def perturbed(guess: Floats, random: np.random.Generator) -> Floats:
    """The guess with noise, about 0.5 m/s and 0.5 N; less for attitude and position."""
    noise = np.concatenate([np.full(3, 0.2), np.full(3, 0.5), np.full(4, 0.1), np.full(3, 0.3)])
    widths = np.concatenate([noise, np.full(guess.shape[1] - STATES - 1, 0.5), [0.0]])
    moved = guess + widths * random.standard_normal(guess.shape)
    moved[:, -1] *= np.exp(random.uniform(np.log(0.3), np.log(1.2)))  # one factor: changes the flight time
    return moved


def _solve_from(transcription: Transcription, guess: Floats) -> tuple[Floats, IpoptStart]:
    """Run IPOPT from rows z_k (N, 13 + m + 1)."""
    began = time.perf_counter()
    answer: dict[str, Any] = transcription.solver(
        x0=guess.ravel(),
        lbx=transcription.lower,
        ubx=transcription.upper,
        lbg=transcription.constraint_lower,
        ubg=transcription.constraint_upper,
    )
    seconds = time.perf_counter() - began
    columns = np.array(answer["x"], dtype=np.float64).reshape(guess.shape)
    statistics = transcription.solver.stats()
    return columns, IpoptStart(
        cost=float(answer["f"]),
        final_time=float(np.trapezoid(columns[:, -1], dx=1.0 / (len(columns) - 1))),
        iterations=int(statistics["iter_count"]),
        seconds=seconds,
        status=str(statistics["return_status"]),
    )


def main() -> None:
    """Print a short table of the three-box problem."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--compiled", action="store_true", help="compile the derivatives to C first")
    compiled = parser.parse_args().compiled
    problem = three_box()
    print(
        "w_t  inner points     cost   t_f s  escape m  defect  build s; each start: cost iterations (seconds)"
    )
    for inner_points in (0, 4):
        for weight_time in (0.0, 5.0):
            run = solve(replace(problem, weight_time=weight_time), inner_points, compiled=compiled)
            flown = fly(problem, run.states, run.controls, run.dilation)
            starts = ", ".join(
                f"{line.cost:.3f} {line.iterations} ({line.seconds:.1f})"
                + ("" if line.status == "Solve_Succeeded" else f" {line.status}")
                for line in run.starts
            )
            print(
                f"{weight_time:3.1f} {inner_points:13d} {run.cost:8.4f} {run.final_time:7.3f} "
                f"{worst_escape(problem, flown[:, :, :3]):9.3f} "
                f"{worst_defect(problem, run.states, flown):7.0e} {run.build_seconds:8.1f}; {starts}",
                flush=True,
            )


if __name__ == "__main__":
    main()
