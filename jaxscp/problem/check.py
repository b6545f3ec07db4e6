"""Checks of a request before anything compiles: shapes, numbers, limits; on request also the user's functions."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxscp.core.arrays import PRECISION, double_precision
from jaxscp.core.errors import InvalidProblem
from jaxscp.core.trees import named_leaves
from jaxscp.problem.boundary import EndCondition, fixed_values
from jaxscp.problem.bounds import WithinBounds
from jaxscp.problem.constraint import Constraint
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.time import FreeTime, Time
from jaxscp.problem.trajectory import Trajectory

STEP = 1e-6  # of differences, relative to the argument's size
# relative error of a derivative that counts as none: far above STEP squared and rounding over STEP
DIFFERENCE = 1e-4
LIMIT = 1e-3  # violation of a limit by a fixed end that counts as none


class Rule(NamedTuple):
    """What must hold, and the message if it does not."""

    holds: Any
    message: str


def check_shapes(problem: OptimalControlProblem, guess: Trajectory) -> None:
    """Raise ``InvalidProblem`` for sizes that contradict each other."""
    if not double_precision():
        raise InvalidProblem(PRECISION)
    nodes = problem.time.nodes
    n, m = problem.dynamics.state_size, problem.dynamics.control_size
    for name, values, size in (("state", guess.state, n), ("control", guess.control, m)):
        if values.shape != (nodes, size):
            raise InvalidProblem(
                f"guess.{name}: expected shape ({nodes}, {size}), as dynamics has {size} {name}s, got {values.shape}."
            )
    for name, values in (("time", guess.time), ("dilation", guess.dilation)):
        if values.shape != (nodes,):
            raise InvalidProblem(f"guess.{name}: expected shape ({nodes},), got {values.shape}.")
    for number in problem.zero_order_hold:
        if not 0 <= number < m:
            raise InvalidProblem(f"zero_order_hold: control {number} does not exist; dynamics has {m}.")
    for name, leaf in named_leaves(problem.time):
        if leaf.shape != ():
            raise InvalidProblem(f"time.{name}: expected one number, got shape {leaf.shape}.")
    for name, c in problem.named_constraints():
        for field in ("tolerance", "soft"):
            value = getattr(c, field)
            if value is not None and getattr(value, "shape", None) != ():
                raise InvalidProblem(f"{name}.{field}: expected one number, got {value}.")
    _check_scale(problem, n, m)


def _check_scale(problem: OptimalControlProblem, n: int, m: int) -> None:
    if problem.scale is not None:
        for name, size in (("state", n), ("control", m)):
            if getattr(problem.scale, name).shape != (size,):
                raise InvalidProblem(
                    f"scale.{name}: expected shape ({size},), got {getattr(problem.scale, name).shape}."
                )


def check_values(problem: OptimalControlProblem, guess: Trajectory) -> None:
    """Raise ``InvalidProblem`` for numbers that contradict each other. Compiles nothing."""
    problem, guess = jax.tree.map(np.asarray, (problem, guess))
    broken = [rule.message for rule in rules(problem, guess, np) if not rule.holds]
    if broken:
        raise InvalidProblem("\n".join(broken))


def rules(problem: OptimalControlProblem, guess: Trajectory, xp: Any) -> Iterator[Rule]:
    """What numbers must obey; ``xp`` is NumPy, or ``jax.numpy`` for an array of answers."""
    for name, leaf in named_leaves(problem):
        if np.issubdtype(leaf.dtype, np.floating):
            yield Rule(xp.all(~xp.isnan(leaf)), f"{name}: holds a value that is not a number (NaN).")
    for name, leaf in named_leaves(guess):
        yield Rule(xp.all(xp.isfinite(leaf)), f"guess.{name}: holds a value that is NaN or infinite.")
    yield Rule(
        xp.all(guess.dilation > 0.0),
        f"guess.dilation: must be positive, is{_value(xp, xp.min(guess.dilation))}.",
    )
    yield from _rules_of_ends(problem, xp)
    yield from _rules_of_time(problem, xp)
    if problem.scale is not None:
        for name, leaf in named_leaves(problem.scale):
            good = xp.all((leaf > 0.0) & xp.isfinite(leaf))
            yield Rule(good, f"scale.{name}: sizes must be positive and finite.")
    for _, c in problem.named_constraints():
        if c.soft is not None:
            yield Rule(
                (c.soft >= 0.0) & xp.isfinite(c.soft),
                f"{c.name}: soft, the weight, must not be negative or infinite, is{_value(xp, c.soft)}. A constraint "
                "without soft holds at any cost.",
            )
        if c.tolerance is not None:
            yield Rule(
                c.tolerance > 0.0, f"{c.name}: tolerance must be positive, is{_value(xp, c.tolerance)}."
            )
        if c.active is not None and c.where.throughout:
            yield Rule(
                ~c.active[-1] | c.active[-2],
                f"{c.name}: active at the last node but not at the one before, so that it holds in no interval there. "
                "Pass where=AtNodes() for a constraint at the last node alone.",
            )
        yield from _rules_of_bounds(problem, c, xp)


def _rules_of_ends(problem: OptimalControlProblem, xp: Any) -> Iterator[Rule]:
    """Ends that are fixed have finite values."""
    for where in ("initial", "final"):
        values = fixed_values(getattr(problem.boundary, where), problem.dynamics.state_size)
        for i, value in enumerate(values or []):
            if value is not None:
                good = ~xp.isinf(value)
                yield Rule(
                    good, f"boundary.{where}: x[{i}] is fixed at{_value(xp, value)}; None leaves it free."
                )


def _value(xp: Any, value: Any) -> str:
    return f" {float(value):g}" if xp is np else ""


def _rules_of_time(problem: OptimalControlProblem, xp: Any) -> Iterator[Rule]:
    yield from _rules_of_mesh(problem.time, xp)
    final = problem.time.final
    if not isinstance(final, FreeTime):
        good = (final.duration > 0.0) & xp.isfinite(final.duration)
        yield Rule(good, f"time.final.duration: must be positive and finite, is{_value(xp, final.duration)}.")
        return
    ranges = [("time.final", final.lower, final.upper)]
    if final.dilation is not None:
        ranges.append(("time.final.dilation", *final.dilation))
    for name, lower, upper in ranges:
        yield Rule(lower > 0.0, f"{name}: the lower limit must be positive, is{_value(xp, lower)}.")
        yield Rule(xp.isfinite(upper), f"{name}: the upper limit must be finite.")
        yield Rule(
            lower <= upper,
            f"{name}: the range is empty: lower{_value(xp, lower)} exceeds upper{_value(xp, upper)}.",
        )
    if final.dilation is not None:
        least, most = final.dilation
        yield Rule(
            (least <= final.upper) & (most >= final.lower),
            "time.final: no final time in its range can be reached with this dilation.",
        )


def _rules_of_mesh(time: Time, xp: Any) -> Iterator[Rule]:
    if (weight := time.mesh_weight) is not None:
        good = (weight >= 0.0) & xp.isfinite(weight)
        yield Rule(good, f"time.mesh_weight: must be finite and not negative, is{_value(xp, weight)}.")
    if (unit := time.mesh_unit) is not None:
        good = (unit > 0.0) & xp.isfinite(unit)
        yield Rule(good, f"time.mesh_unit: must be positive and finite, is{_value(xp, unit)}.")


def _rules_of_bounds(problem: OptimalControlProblem, c: Constraint, xp: Any) -> Iterator[Rule]:
    """Limits of ``bounds`` are in order, and ends that are fixed lie within them."""
    if not isinstance(c.function, WithinBounds):
        return
    sizes = problem.dynamics.state_size, problem.dynamics.control_size
    limits: dict[bool, list[dict[int, Any]]] = {False: [{}, {}], True: [{}, {}]}
    for side, limit in zip(c.function.sides, c.parameters, strict=True):
        chosen = range(sizes[side.of_control]) if side.chosen is None else side.chosen
        values = xp.broadcast_to(limit, (len(chosen),))
        limits[side.of_control][side.upper] |= {component: values[i] for i, component in enumerate(chosen)}
    for of_control, letter in ((False, "x"), (True, "u")):
        lower, upper = limits[of_control]
        for i in sorted(set(lower) & set(upper)):
            words = f"lower{_value(xp, lower[i])}, upper{_value(xp, upper[i])}"
            yield Rule(lower[i] <= upper[i], f"{c.name}: the range of {letter}[{i}] is empty: {words}.")
    for where in ("initial", "final"):
        condition: EndCondition = getattr(problem.boundary, where)
        for i, value in enumerate(fixed_values(condition, sizes[0]) or []):
            for side, sign in ((0, 1.0), (1, -1.0)):
                if value is not None and i in limits[False][side]:
                    limit = limits[False][side][i]
                    yield Rule(
                        sign * (value - limit) >= -LIMIT,
                        f"boundary.{where}: x[{i}] is fixed at{_value(xp, value)}, outside of {c.name!r}, whose limit "
                        f"is{_value(xp, limit)}.",
                    )


# --- the user's functions, on request ---


def check_functions(problem: OptimalControlProblem, guess: Trajectory) -> None:
    """Raise ``InvalidProblem`` if a function or its derivative is not finite at the guess, or the two disagree.

    Derivatives are compared with central differences along a random direction, at every node.

    Args:
        problem: of ``canonical``.
        guess: on its nodes.
    """
    cost, boundary = problem.cost, problem.boundary
    points = guess.state, guess.control, guess.time
    first, last = ((guess.state[i][None], guess.time[i][None]) for i in (0, -1))
    of_last = jax.tree.map(lambda v: v[-1][None], cost.node_parameters())
    rows: list[tuple[str, Callable[..., Any], tuple, Any]] = [
        ("dynamics", lambda x, u, t, _: problem.dynamics(x, u, t), points, ()),
        ("cost.running", cost.running_at, points, cost.node_parameters()),
        ("boundary.initial", lambda x, t, _: boundary.initial.value(x, t), first, ()),
        ("boundary.final", lambda x, t, _: boundary.final.value(x, t), last, ()),
        ("cost.terminal", cost.terminal_at, last, of_last),
    ]
    for field, c in problem.named_constraints():
        if not c.where.across:
            rows.append((f"{field} ({c.name})", c.value, points, c.node_parameters()))
    for row in rows:
        _check_function(*row)


def _check_function(name: str, function: Callable[..., Any], points: tuple, parameters: Any) -> None:
    random = np.random.default_rng(0)
    direction = jax.tree.map(lambda v: random.standard_normal(v.shape) * (1.0 + np.abs(v)), points)

    def one(v, d, p):
        value, slope = jax.jvp(lambda *v: function(*v, p), v, d)
        moved = lambda step: function(*(a + step * b for a, b in zip(v, d, strict=True)), p)  # noqa: E731
        return value, slope, (moved(STEP) - moved(-STEP)) / (2.0 * STEP)

    value, slope, difference = jax.jit(jax.vmap(one))(points, direction, parameters)
    for words, array in (("value", value), ("derivative", slope)):
        bad = ~np.isfinite(np.asarray(array)).reshape(array.shape[0], -1).all(axis=1)
        if bad.any():
            raise InvalidProblem(
                f"{name}: its {words} at node {int(bad.argmax())} of the guess is not finite. A norm or a square root "
                "has no derivative at zero; move the guess, or smooth the function."
            )
    error = np.abs(np.asarray(slope - difference))
    size = 1.0 + np.abs(np.asarray(slope)) + np.abs(np.asarray(value))
    if np.max(error / size, initial=0.0) > DIFFERENCE:
        node = np.unravel_index(int(np.argmax(error / size)), error.shape)[0]
        raise InvalidProblem(
            f"{name}: its derivative differs from differences by {float(np.max(error / size)):.2g} (relative) at node "
            f"{int(node)} of the guess. Is it smooth there, and does it have derivative rules of its own?"
        )
