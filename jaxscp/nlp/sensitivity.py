"""Derivatives of a solution by the implicit function theorem, never by unrolling the iterations.

At the optimum the gradient of the barrier's Lagrangian is zero (``central_path.conditions``). A small change of the
problem moves the optimum by minus the inverse of the conditions' matrix times the change of the conditions. The matrix
is symmetric: forward mode uses it, reverse mode uses it as its own transpose. With the multipliers of the inequalities
eliminated, the matrix is the matrix of the last Newton step (``newton_system.newton_matrix``), factored once by
``riccati``. But beside the weights of active constraints, 1e12 and more, rounding destroys the curvature of weakly
determined directions. So the factor only preconditions the whole system, which has no such weights.

The theorem needs a strict minimum; the recursion notices where there is none. Weakly active and redundant constraints
do no harm: at a small mu, the derivative is the derivative of the smooth path next to them.
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
from jaxscp.nlp.central_path import MU, Point, conditions, lagrangian
from jaxscp.nlp.newton_system import (
    Scalings,
    eliminate_inequalities,
    jacobian_product,
    lagrangian_matrix,
    newton_matrix,
    scaled,
    scalings,
    second_order_model,
)
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.node_values import typical_sizes
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.inequalities import Jacobians, Values, cones, transpose_product
from jaxscp.transcription.shooting import Grid

STEPS, RESTARTS = 6, 2  # of GMRES
TOLERANCE = 1e-13  # of its residual, relative
Unknowns = tuple[riccati.KKTVector, Values]


def implicit_solution(problem: ScaledTimeProblem, point: Point, grid: Grid, is_optimum: Flag) -> Point:
    """The given optimum as a function of the problem: its own value, with the theorem's derivatives.

    Args:
        problem: derivatives are with respect to its arrays of floats.
        point: the optimum of this problem.
        grid: of the integration and the constraints.
        is_optimum: whether the point is an optimum. If not, or if the second-order condition fails there, requested
            derivatives are NaN. They are zero if requested with weight zero, so that a batch element can be masked.
    """
    floats, rest = eqx.partition(problem, eqx.is_inexact_array)
    return _optimum(grid, floats, rest, jax.lax.stop_gradient(point), is_optimum)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _optimum(grid: Grid, floats, rest, point: Point, is_optimum: Flag) -> Point:
    return point


@_optimum.defjvp
def _optimum_jvp(grid: Grid, primals, tangents):
    floats, rest, point, is_optimum = primals
    problem = eqx.combine(first_order_only(floats), rest)
    inner = _with_inner_multipliers(problem, point, is_optimum)
    return point, _change(problem, inner, grid, is_optimum, tangents[0])


def _change(problem: ScaledTimeProblem, point: Point, grid: Grid, is_optimum: Flag, change) -> Point:
    """Change of the optimum with the problem's floats: -A^-1 B change, A and B the derivatives of the conditions.

    Stated as one linear system, [1 0; B A] (f, p) = (change, 0), with solutions of it and of its transpose. Batch
    elements without an optimum then cost nothing, and the others no more memory than one chunk of them.
    """
    right, unravel = ravel_pytree((change, jax.tree.map(jnp.zeros_like, point)))

    def solution(mode):
        def one(fixed, flat, _):
            problem, point = fixed
            system = _system(problem, point, grid)
            found, _ = ravel_pytree(mode(problem, point, system, grid, *unravel(flat)))
            return jnp.where(system.reduced.definite, found, undefined(flat))

        def solve(_, flat):
            found = batching.where_needed(is_optimum, one, (problem, point), flat)
            return jnp.where(is_optimum, found, undefined(flat))

        return solve

    def matrix(flat):
        change, move = unravel(flat)
        return ravel_pytree((change, _conditions_change(problem, point, grid, change, move)))[0]

    found = jax.lax.custom_linear_solve(matrix, right, solution(_forward), solution(_backward))
    return unravel(found)[1]


def _forward(problem: ScaledTimeProblem, point: Point, system: "System", grid: Grid, change, rhs: Point):
    """Solve [1 0; B A] (f, p) = (change, rhs)."""
    caused = _conditions_change(problem, point, grid, change, jax.tree.map(jnp.zeros_like, point))
    return change, system.solve(problem, jax.tree.map(jnp.subtract, rhs, caused))


def _backward(problem: ScaledTimeProblem, point: Point, system: "System", grid: Grid, weights, rhs: Point):
    """Solve [1 B'; 0 A] (f, p) = (weights, rhs)."""
    adjoint = system.solve(problem, rhs)
    floats, rest = eqx.partition(problem, eqx.is_inexact_array)

    def product(floats):  # has the gradient of adjoint . conditions, with one integration less
        return jax.jvp(lambda p: lagrangian(eqx.combine(floats, rest), p, grid), (point,), (adjoint,))[1]

    return jax.tree.map(jnp.subtract, weights, jax.grad(product)(floats)), adjoint


def _conditions_change(problem: ScaledTimeProblem, point: Point, grid: Grid, change, move: Point) -> Point:
    """B change + A move."""
    floats, rest = eqx.partition(problem, eqx.is_inexact_array)
    value = lambda floats, point: conditions(eqx.combine(floats, rest), point, grid)  # noqa: E731
    return jax.jvp(value, (floats, point), (change, move))[1]


def _with_inner_multipliers(problem: ScaledTimeProblem, point: Point, is_optimum: Flag) -> Point:
    """The point, with multipliers inside their cones where it is no optimum: masked numbers must be finite."""
    multipliers = tuple(
        jnp.where(is_optimum, y, jnp.broadcast_to(cone.identity(y.shape[-1]), y.shape))
        for cone, y in zip(cones(problem), point.y.values, strict=True)
    )
    return eqx.tree_at(lambda p: p.y.values, point, multipliers)


@jax.custom_jvp
def without_derivative(value: Array, problem: ScaledTimeProblem) -> Array:
    """The value, with no derivative with respect to the problem: to request one is an error, not zero."""
    return value


@without_derivative.defjvp
def _without_derivative_jvp(primals, tangents):
    raise TypeError(
        "this plan has no derivative: the methods of the paper stop at points that are no optima. Plan with "
        "Planner(method=NewtonSCP()), the default, or take the gradient of something that does not depend on the plan"
    )


class System(eqx.Module):
    """Matrix of the derivatives of the conditions, [H A' -J'; A 0 0; -J 0 -W^2].

    Its unknowns are scaled node variables, multipliers of the equalities, and multipliers of the inequalities.
    """

    lagrangian: riccati.LQProblem
    """H and A."""
    jacobians: Jacobians
    """J, in the variables' own units."""
    scalings: Scalings
    """W."""
    scale: Float[Array, "variables"]
    reduced: riccati.Factor
    """Factor of H + J' W^-2 J and A."""

    def solve(self, problem: ScaledTimeProblem, right: Point) -> Point:
        """Solution for one right-hand side, by GMRES with the factor as preconditioner.

        The factor is wrong in few directions only, so that a few steps do the work of fifty refinements.
        """
        y = right.y
        side = scaled(riccati.KKTVector(right.z, y.flow, y.initial, y.final), self.scale)
        (side, multipliers), _ = gmres(
            lambda x: self._apply(problem, x),
            (side, y.values),
            M=lambda x: self._precondition(problem, x),
            solve_method="incremental",
            tol=TOLERANCE,
            restart=STEPS,
            maxiter=RESTARTS,
        )
        side = scaled(side, self.scale)
        return Point(side.nodes, Multipliers(side.flow, side.initial, side.final, multipliers))

    def _apply(self, problem: ScaledTimeProblem, x: Unknowns) -> Unknowns:
        """The matrix times a vector."""
        side, y = x
        out = riccati.apply(self.lagrangian, side)
        nodes = out.nodes - self.scale * transpose_product(problem, self.jacobians, y)
        derivatives = jacobian_product(problem, self.jacobians, self.scale * side.nodes)
        rows = tuple(-d - w.square(v) for d, w, v in zip(derivatives, self.scalings, y, strict=True))
        return eqx.tree_at(lambda s: s.nodes, out, nodes), rows

    def _precondition(self, problem: ScaledTimeProblem, right: Unknowns) -> Unknowns:
        """Solution by the factor, with y = -W^-2 (right_y + J z)."""
        side, rows = right
        weighted = tuple(w.inverse_square(r) for w, r in zip(self.scalings, rows, strict=True))
        nodes = side.nodes - self.scale * transpose_product(problem, self.jacobians, weighted)
        found = riccati.solve(self.reduced, eqx.tree_at(lambda s: s.nodes, side, nodes), refinements=0)
        derivatives = jacobian_product(problem, self.jacobians, self.scale * found.nodes)
        y = tuple(-w.inverse_square(r + d) for w, r, d in zip(self.scalings, rows, derivatives, strict=True))
        return found, y


@functools.partial(jax.jit, static_argnums=2)
def _system(problem: ScaledTimeProblem, point: Point, grid: Grid) -> System:
    """The factored matrix."""
    model, scale = second_order_model(problem, point.z, point.y, grid), typical_sizes(point.z)
    slack = tuple(
        -MU * cone.barrier_gradient(y) for cone, y in zip(cones(problem), point.y.values, strict=True)
    )
    w = scalings(problem, slack, point.y.values)
    eliminated = eliminate_inequalities(problem, model.jacobians, w)
    return System(
        lagrangian=lagrangian_matrix(problem, model, scale),
        jacobians=model.jacobians,
        scalings=w,
        scale=scale,
        reduced=riccati.factor(newton_matrix(problem, model, eliminated, scale)),
    )
