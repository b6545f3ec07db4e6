"""Derivatives of a plan by the implicit function theorem, never by unrolling the iterations.

At the optimum the gradient of the barrier's Lagrangian is zero (``central_path.conditions``), so that a small change of
the problem moves it by minus the inverse of the conditions' matrix times their own change. The matrix is that of the
last Newton step (``interior.newton_chain``): symmetric, factored once by ``riccati``, and used in forward mode as it
stands, in reverse mode as its own transpose.

The theorem needs a strict minimum, which the recursion notices where it fails. Weakly active constraints, and several
that say the same, do no harm: at a small mu, the derivative is that of the smooth path next to them.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxscp import riccati
from jaxscp.central_path import Point, conditions, multipliers
from jaxscp.implicit import symmetric_solve
from jaxscp.interior import local, newton_chain, scaled, unscaled, weightings
from jaxscp.intervals import Grid
from jaxscp.problem import OptimalControlProblem, typical_sizes
from jaxscp.types import Flag


def follow(problem: OptimalControlProblem, point: Point, grid: Grid, reached: Flag) -> Point:
    """The optimum that was found, as a function of the problem: its own value, and the theorem's derivatives.

    Args:
        problem: derivatives are with respect to its arrays of floats.
        point: the optimum of this problem.
        grid: of the integration and the constraints that it was found with.
        reached: whether it is one. If not, or if the second-order condition fails there, derivatives that are asked
            for are NaN (and zero if they are asked for with weight zero, so that a lane can be masked).
    """
    floats, rest = eqx.partition(problem, eqx.is_inexact_array)
    return _optimum(grid, floats, rest, jax.lax.stop_gradient(point), reached)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _optimum(grid: Grid, floats, rest, point: Point, reached: Flag) -> Point:
    return point


@_optimum.defjvp
def _moved(grid: Grid, primals, tangents):
    from jaxopt import implicit_diff  # here, since few programs ask for a derivative and it is slow to import

    floats, rest, point, reached = primals

    def residual(point, floats):
        return conditions(eqx.combine(floats, rest), point, grid)

    def solve(_, right):
        return _solve(eqx.combine(floats, rest), point, grid, reached, right)

    return point, implicit_diff.root_jvp(residual, point, (floats,), tangents[:1], solve=solve)


@jax.custom_jvp
def without_derivative(value: Array, problem: OptimalControlProblem) -> Array:
    """An answer to the problem that has no derivative with respect to it: asking for one is an error, not zero."""
    return value


@without_derivative.defjvp
def _refuse(primals, tangents):
    raise TypeError(
        "this plan has no derivative: the methods of the paper stop at points that are no optima. Plan with "
        "Planner(method=NewtonSCP()), the default, or take the gradient of something that does not depend on the plan"
    )


def _solve(problem: OptimalControlProblem, point: Point, grid: Grid, reached: Flag, right: Point) -> Point:
    """Solve with the matrix of the conditions' derivatives."""
    build = lambda: _matrix(problem, point, grid)  # noqa: E731
    shapes = jax.eval_shape(build)
    # A branch, though all lanes of a batch take both: XLA sets its memory aside only while it runs.
    factor = jax.lax.cond(reached, build, lambda: jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), shapes))
    scale = typical_sizes(point.z)
    found = symmetric_solve(
        lambda v: riccati.apply(factor.chain, v),
        lambda v: riccati.solve(factor, v),
        scaled(right, scale),
        reached & factor.definite,
    )
    return unscaled(found, scale)


@functools.partial(jax.jit, static_argnums=2)
def _matrix(problem: OptimalControlProblem, point: Point, grid: Grid) -> riccati.Factor:
    """The matrix, factored."""
    y = multipliers(problem, point, grid)
    here = local(problem, point.z, y, grid)
    weigh = weightings(problem, here.values, y.values)
    return riccati.factor(newton_chain(problem, here, weigh, typical_sizes(point.z)))
