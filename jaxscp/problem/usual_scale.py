"""Typical sizes of a problem that states none, from its guess, its limits and its dynamics.

A solver's barrier, tolerances and weights suit numbers of about one. So sizes from 1/30 to 30 count as one, and others
are rounded to powers of ten: the same problem in other units is then the same numbers, and a small change of a problem
changes no size.

Known are a variable's range over the guess, and a control's distance from its limits. The rest lies between two
bounds. A state cannot move further than its rate carries it in the whole time; and a variable that alone moves another
one must be large enough to do so in that time.

At a solution, the largest value of a control is known, and its limits do not count: a large one may stand for none.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscp.core.types import Flag, Scalar
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.scale import Scale
from jaxscp.problem.sizes import or_one
from jaxscp.problem.time import FreeTime
from jaxscp.problem.trajectory import Trajectory

ABOUT_ONE = 30.0  # sizes up to this, and down to its inverse, count as one
ROUNDING = 1e-13  # of the largest size: a smaller one counts as zero
FAR = 30.0  # a factor between two sizes that matters
NOISE = 1e-6  # of the size in which a solution was found: a smaller change of it counts as zero
OVERSTATED = 3.0  # a change of the cost is the sum of the changes by all variables, as if none cancelled


def usual_scale(problem: OptimalControlProblem, guess: Trajectory, before: Scale | None = None) -> Scale:
    """Sizes of states, controls, time and cost; without derivatives.

    Args:
        problem: of ``canonical``.
        guess: to measure them at.
        before: sizes in which it was found, if it is a solution.
    """
    problem, guess, before = jax.lax.stop_gradient((problem, guess, before))
    time, states = guess.time[-1], guess.state.shape[1]
    if before is None:
        sizes, cost = _at_guess(problem, guess), jnp.zeros(())
    else:
        sizes, used = _at_solution(problem, guess, before)
        cost = _change_of_cost(problem, guess, jnp.where(used, sizes, 0.0))
    cost = jnp.where(cost > 0.0, cost, or_one(_change_of_cost(problem, guess, sizes)))
    return Scale(
        state=_rounded(sizes[:states]),
        control=_rounded(sizes[states:]),
        time=_rounded(time),
        cost=_rounded_cost(cost),
    )


def far(sizes: Array, others: Array) -> Flag:
    """Whether one of the sizes is far from the other one."""
    return jnp.any((sizes > FAR * others) | (FAR * sizes < others))


def _at_guess(problem: OptimalControlProblem, guess: Trajectory) -> Float[Array, "variables"]:
    """From ranges over the guess, and larger distances of controls from their limits."""
    known = jnp.concatenate([jnp.ptp(guess.state, axis=0), jnp.ptp(guess.control, axis=0)])
    return _sizes(problem, guess, jnp.maximum(known, _distances_of_controls(problem, guess)))


def _at_solution(
    problem: OptimalControlProblem, plan: Trajectory, before: Scale
) -> tuple[Float[Array, "variables"], Bool[Array, "variables"]]:
    """From ranges of states and largest values of controls; and whether the solution uses each variable.

    Wrong sizes of states may lead to no solution, which hardly uses controls that it needs: then these count as unused.
    An unused control has its distance from its limits; if these are so far that they stand for none, what it needs.
    """
    states, sizes_before = plan.state.shape[1], jnp.concatenate([before.state, before.control])
    known = jnp.concatenate([jnp.ptp(plan.state, axis=0), jnp.max(jnp.abs(plan.control), axis=0)])
    known = jnp.where(known > NOISE * sizes_before, known, 0.0)
    needed = _needed(known[:states], _influence(problem, plan, known)[1])
    distances = _distances_of_controls(problem, plan)
    none = (distances == 0.0) | (NOISE * distances > needed)
    distances = jnp.where((needed > 0.0) & none, needed, distances)
    unused = _sizes(problem, plan, jnp.concatenate([known[:states], distances[states:]]))
    wrong = far(_rounded(unused[:states]), before.state)
    sizes = _sizes(problem, plan, jnp.where(known > 0.0, known, distances))
    return jnp.where(wrong, unused, sizes), known > 0.0


def _distances_of_controls(problem: OptimalControlProblem, guess: Trajectory) -> Float[Array, "variables"]:
    """Largest distances of controls from their limits; zero for states, and for controls without limits."""
    return _distance_from_limits(problem, guess).at[: guess.state.shape[1]].set(0.0)


def _sizes(
    problem: OptimalControlProblem, guess: Trajectory, known: Float[Array, "variables"]
) -> Float[Array, "variables"]:
    """Of states and controls, before rounding; the number nearest to one where only bounds are known."""
    states = guess.state.shape[1]
    own, others = _influence(problem, guess, known)
    known = jnp.concatenate([_without_rounding(_finite(part)) for part in (known[:states], known[states:])])

    def narrow(_, bounds: tuple[Array, Array]):
        least, most = bounds
        reach = own + others @ jnp.where(jnp.isfinite(most), most, 0.0)
        # estimated once: cycles of states would raise it for ever
        first = jnp.isinf(most[:states]) & (reach > 0.0)
        most = most.at[:states].set(jnp.where(first, reach, most[:states]))
        least = jnp.maximum(least, _needed(least[:states], others))
        return jnp.where(known > 0.0, known, least), most

    none = jnp.where(known > 0.0, known, 0.0), jnp.where(known > 0.0, known, jnp.inf)
    least, most = jax.lax.fori_loop(0, len(known), narrow, none)
    return jnp.where(least > most, jnp.sqrt(least * most), jnp.clip(1.0, least, most))


def _influence(
    problem: OptimalControlProblem, guess: Trajectory, known: Float[Array, "variables"]
) -> tuple[Float[Array, "states"], Float[Array, "states variables"]]:
    """Change of each state in the whole time: by its own rate, and by one unit of each other variable."""
    time, states = guess.time[-1], guess.state.shape[1]
    rates, slopes = _largest_rates(problem, guess)
    own = _without_rounding(jnp.concatenate([_finite(known[:states]), time * rates]))[states:]
    return own, _without_rounding(time * slopes * (1.0 - jnp.eye(states, len(known))))


def _needed(
    changes: Float[Array, "states"], others: Float[Array, "states variables"]
) -> Float[Array, "variables"]:
    """Least size of each variable that alone moves a state, for the states to change by so much."""
    alone = (others > 0.0) & (jnp.sum(others > 0.0, axis=1, keepdims=True) == 1)
    return jnp.max(
        jnp.where(alone, changes[:, None] / jnp.where(alone, others, 1.0), 0.0), axis=0, initial=0.0
    )


def _distance_from_limits(problem: OptimalControlProblem, guess: Trajectory) -> Float[Array, "variables"]:
    """Largest distance of each variable from a limit of this variable alone, along the guess; zero without one."""
    found = jnp.zeros(guess.state.shape[1] + guess.control.shape[1])
    for c in problem.constraints:
        if c.where.across or c.cone.curved:
            continue
        function = c.with_parameters(c.function)
        nodes = guess.state, guess.control, guess.time, c.node_parameters()
        values = jax.vmap(function)(*nodes)
        slopes = jnp.concatenate(jax.vmap(jax.jacfwd(function, argnums=(0, 1)))(*nodes), axis=-1)
        single = jnp.sum(slopes != 0.0, axis=-1, keepdims=True) == 1
        distance = jnp.abs(values[..., None] / jnp.where(slopes == 0.0, 1.0, slopes))
        counts = single & (slopes != 0.0) & jnp.isfinite(distance)
        found = jnp.maximum(found, jnp.max(jnp.where(counts, distance, 0.0), axis=(0, 1), initial=0.0))
    return found


def _largest_rates(
    problem: OptimalControlProblem, guess: Trajectory
) -> tuple[Float[Array, "states"], Float[Array, "states variables"]]:
    """Largest rates along the guess, and their largest derivatives; infinite or undefined ones count as none."""
    nodes = guess.state, guess.control, guess.time
    slopes = jax.vmap(jax.jacfwd(problem.dynamics, argnums=(0, 1)))(*nodes)
    both = jax.vmap(problem.dynamics)(*nodes), jnp.concatenate(slopes, axis=-1)
    rates, slopes = (jnp.max(_finite(jnp.abs(v)), axis=0) for v in both)
    return rates, slopes


def _change_of_cost(
    problem: OptimalControlProblem, guess: Trajectory, sizes: Float[Array, "variables"]
) -> Scalar:
    """Change of a guess's cost, if each variable and the time change by their own sizes."""
    cost, states = problem.cost, guess.state.shape[1]
    parameters = cost.node_parameters()
    steps = jnp.concatenate([jnp.diag(sizes), -jnp.diag(sizes)])

    def running(x, u, t, p):
        rate = lambda step: cost.running_at(x + step[:states], u + step[states:], t, p)  # noqa: E731
        here = cost.running_at(x, u, t, p)
        return here, _largest_changes(jax.vmap(rate)(steps), here)

    time = guess.time[-1]
    rates, changes = jax.vmap(running)(guess.state, guess.control, guess.time, parameters)
    change = time * jnp.mean(changes)
    if isinstance(problem.time.final, FreeTime):
        change += time * _finite(jnp.abs(jnp.mean(rates)))
    return change + _change_at_the_end(problem, guess, steps[:, :states])


def _change_at_the_end(
    problem: OptimalControlProblem, guess: Trajectory, steps: Float[Array, "steps states"]
) -> Scalar:
    """Of the terminal cost."""
    cost, last, time = problem.cost, guess.state[-1], guess.time[-1]
    parameters = jax.tree.map(lambda v: v[-1], cost.node_parameters())
    here = cost.terminal_at(last, time, parameters)
    moved = jax.vmap(lambda step: cost.terminal_at(last + step, time, parameters))(steps)
    change = _largest_changes(moved, here)
    if isinstance(problem.time.final, FreeTime):
        change += _finite(jnp.abs(cost.terminal_at(last, 2.0 * time, parameters) - here))
    return change


def _largest_changes(moved: Float[Array, "steps"], here: Scalar) -> Scalar:
    """Sum over the variables of the larger change, of a step forth and one back."""
    changes = _finite(jnp.abs(moved - here)).reshape(2, -1)
    return jnp.sum(jnp.max(changes, axis=0, initial=0.0))


def _finite(v: Array) -> Array:
    return jnp.where(jnp.isfinite(v), v, 0.0)


def _without_rounding(sizes: Float[Array, "*b n"]) -> Float[Array, "*b n"]:
    """Rows of sizes, and zero for those that only rounding has made, as of a guess in a plane."""
    largest = jnp.max(sizes, axis=-1, keepdims=True, initial=0.0)
    return jnp.where(sizes > ROUNDING * largest, sizes, 0.0)


def _rounded(size: Array) -> Array:
    """The nearest power of ten, or one."""
    power = 10.0 ** jnp.round(jnp.log10(size))
    return jnp.where((size > ABOUT_ONE) | (size < 1.0 / ABOUT_ONE), power, 1.0)


def _rounded_cost(size: Scalar) -> Scalar:
    """A power of ten that is rather too small: the barrier moves the optimum by a millionth of this for each limit."""
    power = 10.0 ** jnp.floor(jnp.log10(size / OVERSTATED))
    return jnp.where((size >= 1.0) & (size <= ABOUT_ONE), 1.0, power)
