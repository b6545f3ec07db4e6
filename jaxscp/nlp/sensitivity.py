"""Derivatives of a plan by the implicit function theorem, never by unrolling the iterations.

At the optimum the gradient of the barrier's Lagrangian is zero (``central_path.conditions``), so that a small change of
the problem moves it by minus the inverse of the conditions' matrix times their own change. The matrix is symmetric:
used in forward mode as it stands, in reverse mode as its own transpose. With the prices of inequalities eliminated it
is that of the last Newton step (``interior.newton_chain``), factored once by ``riccati``. But next to the weights of
what is active, 1e12 and more, rounding leaves little of a soft direction's curvature; so the factor only preconditions
the whole system, which knows no such numbers.

The theorem needs a strict minimum, which the recursion notices where it fails. Weakly active constraints, and several
that say the same, do no harm: at a small mu, the derivative is that of the smooth path next to them.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.scipy.sparse.linalg import gmres
from jaxtyping import Array, Float

from jaxscp.core import batching
from jaxscp.core.implicit import first_order_only, undefined
from jaxscp.core.types import Flag
from jaxscp.linalg import riccati
from jaxscp.nlp.central_path import MU, Point, conditions, inverse, lagrangian
from jaxscp.nlp.newton_system import (
    Scalings,
    along,
    lagrangian_chain,
    local,
    newton_chain,
    scaled,
    scalings,
    weighed,
)
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import OptimalControlProblem, typical_sizes
from jaxscp.transcription.inequalities import Jacobians, Values, cones, pulled, unit
from jaxscp.transcription.shooting import Grid

STEPS, RESTARTS = 6, 2  # of GMRES
TOLERANCE = 1e-13  # of its residual, relative
Unknowns = tuple[riccati.KKTVector, Values]


def implicit_solution(problem: OptimalControlProblem, point: Point, grid: Grid, reached: Flag) -> Point:
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
    floats, rest, point, reached = primals
    problem = eqx.combine(first_order_only(floats), rest)
    inner = _inside(problem, point, reached)
    return point, _change(problem, inner, grid, reached, tangents[0])


def _change(problem: OptimalControlProblem, point: Point, grid: Grid, reached: Flag, change) -> Point:
    """Of the optimum with the problem's floats: minus the inverse of the conditions' matrix A times their own change
    B. As one linear system, [1 0; B A] (f, p) = (change, 0), whose solution and that of its transpose are stated: of a
    batch, lanes that have none then cost nothing, and the others no more memory than a tile of them."""
    right, unravel = ravel_pytree((change, jax.tree.map(jnp.zeros_like, point)))

    def solution(act):
        def one(fixed, flat):
            problem, point = fixed
            system = _system(problem, point, grid)
            found, _ = ravel_pytree(act(problem, point, system, grid, *unravel(flat)))
            return jnp.where(system.reduced.definite, found, undefined(flat))

        def solve(_, flat):
            found = batching.where_needed(reached, one, (problem, point), flat)
            return jnp.where(reached, found, undefined(flat))

        return solve

    def matrix(flat):
        change, move = unravel(flat)
        return ravel_pytree((change, _moved_conditions(problem, point, grid, change, move)))[0]

    found = jax.lax.custom_linear_solve(matrix, right, solution(_forward), solution(_backward))
    return unravel(found)[1]


def _forward(problem: OptimalControlProblem, point: Point, system: "System", grid: Grid, change, owed: Point):
    """Solve [1 0; B A] (f, p) = (change, owed)."""
    caused = _moved_conditions(problem, point, grid, change, jax.tree.map(jnp.zeros_like, point))
    return change, system.solve(problem, jax.tree.map(jnp.subtract, owed, caused))


def _backward(
    problem: OptimalControlProblem, point: Point, system: "System", grid: Grid, weights, asked: Point
):
    """Solve [1 B'; 0 A] (f, p) = (weights, asked)."""
    price = system.solve(problem, asked)
    floats, rest = eqx.partition(problem, eqx.is_inexact_array)

    def along(floats):  # its gradient is that of price . conditions, with one sweep through the flight less
        return jax.jvp(lambda p: lagrangian(eqx.combine(floats, rest), p, grid), (point,), (price,))[1]

    return jax.tree.map(jnp.subtract, weights, jax.grad(along)(floats)), price


def _moved_conditions(problem: OptimalControlProblem, point: Point, grid: Grid, change, move: Point) -> Point:
    """B change + A move."""
    floats, rest = eqx.partition(problem, eqx.is_inexact_array)
    value = lambda floats, point: conditions(eqx.combine(floats, rest), point, grid)  # noqa: E731
    return jax.jvp(value, (floats, point), (change, move))[1]


def _inside(problem: OptimalControlProblem, point: Point, reached: Flag) -> Point:
    """The point, with prices inside their cones also where it is no optimum: what is masked must be finite."""
    prices = tuple(
        jnp.where(reached, y, jnp.broadcast_to(unit(cone, y.shape[-1]), y.shape))
        for cone, y in zip(cones(problem), point.y.values, strict=True)
    )
    return eqx.tree_at(lambda p: p.y.values, point, prices)


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


class System(eqx.Module):
    """Matrix of the conditions' derivatives: [H A' -J'; A 0 0; -J 0 -W^2] over scaled node variables, multipliers of
    the equalities, and prices."""

    lagrangian: riccati.LQProblem
    """H and A."""
    jacobians: Jacobians
    """J, in the variables' own units."""
    scalings: Scalings
    """W."""
    scale: Float[Array, "variables"]
    reduced: riccati.Factor
    """Of H + J' W^-2 J and A."""

    def solve(self, problem: OptimalControlProblem, right: Point) -> Point:
        """For one right-hand side. Few directions are far from what the factor says of them, so that a few of GMRES's
        steps do what refinement would need fifty for."""
        y = right.y
        side = scaled(riccati.KKTVector(right.z, y.flow, y.initial, y.final), self.scale)
        (side, prices), _ = gmres(
            lambda x: self._apply(problem, x),
            (side, y.values),
            M=lambda x: self._eliminated(problem, x),
            solve_method="incremental",
            tol=TOLERANCE,
            restart=STEPS,
            maxiter=RESTARTS,
        )
        side = scaled(side, self.scale)
        return Point(side.nodes, Multipliers(side.flow, side.initial, side.final, prices))

    def _apply(self, problem: OptimalControlProblem, x: Unknowns) -> Unknowns:
        """Times a vector."""
        side, y = x
        out = riccati.apply(self.lagrangian, side)
        nodes = out.nodes - self.scale * pulled(problem, self.jacobians, y)
        slopes = along(problem, self.jacobians, self.scale * side.nodes)
        rows = tuple(-slope - w.square(v) for slope, w, v in zip(slopes, self.scalings, y, strict=True))
        return eqx.tree_at(lambda s: s.nodes, out, nodes), rows

    def _eliminated(self, problem: OptimalControlProblem, right: Unknowns) -> Unknowns:
        """By the factor: y = -W^-2 (right_y + J z)."""
        side, rows = right
        weighted = tuple(w.inverse_square(r) for w, r in zip(self.scalings, rows, strict=True))
        nodes = side.nodes - self.scale * pulled(problem, self.jacobians, weighted)
        found = riccati.solve(self.reduced, eqx.tree_at(lambda s: s.nodes, side, nodes), refinements=0)
        slopes = along(problem, self.jacobians, self.scale * found.nodes)
        y = tuple(-w.inverse_square(r + v) for w, r, v in zip(self.scalings, rows, slopes, strict=True))
        return found, y


@functools.partial(jax.jit, static_argnums=2)
def _system(problem: OptimalControlProblem, point: Point, grid: Grid) -> System:
    """The matrix, factored."""
    here, scale = local(problem, point.z, point.y, grid), typical_sizes(point.z)
    slack = tuple(MU * inverse(cone, y) for cone, y in zip(cones(problem), point.y.values, strict=True))
    weigh = scalings(problem, slack, point.y.values)
    return System(
        lagrangian=lagrangian_chain(problem, here, scale),
        jacobians=here.jacobians,
        scalings=weigh,
        scale=scale,
        reduced=riccati.factor(newton_chain(problem, here, weighed(problem, here.jacobians, weigh), scale)),
    )
