"""The conic step as a differentiable layer: the solution of a program as a function of the program.

What is differentiated is the point of the central path at a mu near rounding: where

    P x + q + A'y = 0,    A x + s = b,    s o y = mu e

for the program in conic form, min 1/2 x'Px + q'x, A x + s = b, s in K. Newton's method takes the interior point's
answer there, and by the implicit function theorem a change of the program's data moves x and y by

    [ P   A'  ] [dx]     [ dP x + dq + dA'y ]
    [ A  -W^2 ] [dy] = - [ dA x - db        ],

with W the Nesterov-Todd scaling of the central pair (``augmented`` says how that is solved). The iterations are not
differentiated. By the envelope theorem, the optimal value moves as the Lagrangian does at fixed x and y.

Agrawal, Barratt, Boyd, Busseti and Moursi ("Differentiating through a cone program", 2019) differentiate the projection
onto the cone at the optimum itself, mu = 0. The two agree where that projection is differentiable, up to mu. Where it
is not, because a constraint is weakly active, the path still has a derivative: one between those of its two sides.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxscp.cones.product import ConeVector
from jaxscp.conic import kkt
from jaxscp.conic.augmented import System, Unknowns, factorise
from jaxscp.conic.central_path import centre, conditions, lagrangian
from jaxscp.conic.equilibrate import scaled_by
from jaxscp.conic.interior_point import InteriorPoint, restored
from jaxscp.conic.kkt import Primal
from jaxscp.conic.program import ConicSolution, StagedProgram
from jaxscp.conic.smoothing import central_pair
from jaxscp.core.implicit import first_order_only, symmetric_solve
from jaxscp.core.status import Status
from jaxscp.core.trees import tree_axpy
from jaxscp.core.types import Flag, Scalar

_SOLVED = 1e-8  # relative residual at which a linear system counts as solved
_STRICT = 1e-6  # relative; to what the system has to recover a known change of z


class LayerSolution(ConicSolution):
    """A solution whose ``z``, ``multipliers`` and ``objective`` have derivatives with respect to the program."""

    differentiable: Flag
    """Whether the point is on the central path, and the only optimum to within rounding."""


class ConicLayer(eqx.Module):
    """Solves a ``StagedProgram``, with derivatives in forward and reverse mode, under ``jit`` and ``vmap``.

    Derivatives are with respect to every float of the program but the choice ``links.soft``, whose derivative is zero;
    they are of first order: a second is a ``TypeError``. The Hessian counts as its symmetric part.

    Where the program has no solution, or the iterations did not find it, ``z`` and ``multipliers`` are the interior
    point's, and derivatives that are asked for are NaN (and zero if they are asked for with weight zero, so that a lane
    can be masked with ``differentiable``). So are those in directions, forward or reverse, in which the linear system
    has no accurate solution: along a face of many optima, and where redundant links would contradict each other. In
    other directions redundant links do no harm. The derivative of ``objective`` is made of multipliers alone: where
    these are not unique, it holds for changes after which the program still has a solution.

    Args:
        solver: the interior point that comes first.
        mu: of the central path, in equilibrated units: of slack times multiplier.
        tolerance: of the path's conditions, relative to the largest entry of q and b.
        steps: Newton steps allowed from the interior point's answer to the path.

    Example:
        >>> import equinox as eqx, jax
        >>> from jaxscp.conic import ConicLayer
        >>> from jaxscp.conic.random_programs import smallest_program
        >>> program = smallest_program()
        >>> def cost(target):  # of the way from 0 to the target in one step: target^2 / 2
        ...     moved = eqx.tree_at(lambda p: p.links.offset, program, program.links.offset.at[2, 0].set(target))
        ...     return ConicLayer()(moved).objective
        >>> value, slope = jax.jit(jax.value_and_grad(cost))(1.5)
        >>> f"{value:.6f} {slope:.6f}"
        '1.125000 1.500000'
    """

    solver: InteriorPoint = eqx.field(default_factory=InteriorPoint)
    mu: float = eqx.field(default=1e-12, static=True)
    tolerance: float = eqx.field(default=1e-11, static=True)
    steps: int = eqx.field(default=20, static=True)

    def __call__(self, program: StagedProgram) -> LayerSolution:
        """Solve a program.

        Returns:
            A ``LayerSolution``. Where ``differentiable``, its ``z`` and ``multipliers`` are those of the central path,
            exact to about ``mu``; they may differ from the interior point's by its own tolerance. A point of the path
            has converged, also where the interior point came only near it; other statuses are the interior point's.
        """
        program = _with_symmetric_hessian(program)
        given = jax.lax.stop_gradient(program)
        ended = self.solver.iterate(given)
        scales, scaled = ended.scales, scaled_by(given, ended.scales)
        x, y, s = ended.iterate.solution()
        point = centre(scaled, x, tree_axpy(-1.0, y, s), self.mu, self.tolerance, self.steps)
        reached = point.error <= self.tolerance  # which proves it optimal, whatever ended the interior point
        status = Status.where(reached, Status.converged, self.solver.status(ended))
        # a matrix of finite numbers also where it has no meaning: zero times NaN would not be zero
        pair = central_pair(jax.tree.map(lambda v: jnp.where(reached, v, 1.0), point.gap), self.mu)
        matrix = factorise(scaled, pair)
        x, y = jax.tree.map(lambda a, b: jnp.where(reached, a, b), (point.x, pair.y), (x, y))
        cost = scales.cost * given.objective(scales.columns * x.z)
        x, y, cost = _followed(scaled_by(program, scales), (x, y, cost), matrix, reached)
        z, multipliers = restored(scaled, scales, x, y)
        return LayerSolution(
            z, multipliers, cost / scales.cost, status, ended.iterations, reached & _strict(matrix)
        )


Optimum = tuple[Primal, ConeVector, Scalar]
"""x, y and the optimal value, in equilibrated units."""


@jax.custom_jvp
def _followed(program: StagedProgram, optimum: Optimum, matrix: System, reached: Flag) -> Optimum:
    """The optimum that was found, as a function of the program: its own value, and the theorem's derivatives."""
    return optimum


@_followed.defjvp
def _moved(primals, tangents):
    from jaxopt import implicit_diff  # here, since few programs ask for a derivative and it is slow to import

    program, optimum, matrix, reached = primals

    def residual(optimum, program):
        x, y, cost = optimum
        return *conditions(program, x, y, matrix.pair.s), cost - lagrangian(program, x, y)

    def solve(_, right):
        return _solve(matrix, reached, right)

    return optimum, implicit_diff.root_jvp(
        residual, optimum, (first_order_only(program),), tangents[:1], solve=solve
    )


def _solve(matrix: System, reached: Flag, right: Optimum) -> Optimum:
    """Solve for the change of the optimum; that of the value stands alone, but is as defined as the rest."""
    dual, primal, cost = right
    dx, v, dcost = symmetric_solve(
        lambda u: (*matrix.times(u[:2]), u[2]),
        lambda u: (*_accurate(matrix, u[:2]), u[2]),
        (dual, matrix.scaled(primal), cost),
        reached,
    )
    return dx, matrix.scaled(v), dcost


def _accurate(matrix: System, right: Unknowns) -> Unknowns:
    """The solution, or NaN where the matrix has none: it is singular in this direction, or nearly so."""
    found, lack = matrix.solve(right)
    return jax.tree.map(lambda v: jnp.where(lack <= _SOLVED, v, jnp.nan), found)


def _strict(matrix: System) -> Flag:
    """Whether the system recovers a change of z from its own product with it: not if another optimum is as good."""
    program = matrix.program
    z = (
        jnp.cos(jnp.arange(program.gradient.size))
        .astype(program.gradient.dtype)
        .reshape(program.gradient.shape)
    )
    nothing = jax.tree.map(jnp.zeros_like, (kkt.linear_cost(program), kkt.right_side(program)))
    probe = eqx.tree_at(lambda u: u[0].z, nothing, z)
    (found, _), _ = matrix.solve(matrix.times(probe))
    return jnp.max(jnp.abs(found.z - z)) <= _STRICT


def _with_symmetric_hessian(program: StagedProgram) -> StagedProgram:
    """The program as its cost reads it, and with the choice of soft rows fixed."""
    hessian = 0.5 * (program.hessian + jnp.swapaxes(program.hessian, 1, 2))
    return eqx.tree_at(
        lambda p: (p.hessian, p.links.soft), program, (hessian, jax.lax.stop_gradient(program.links.soft))
    )
