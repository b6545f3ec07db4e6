"""Differentiable conic layer: the solution of a program as a function of the program.

The layer differentiates the central point at a mu near rounding,

    P x + q + A'y = 0,    A x + s = b,    s o y = mu e,

for the program in conic form, min 1/2 x'Px + q'x, A x + s = b, s in K. Newton's method finds this point from the
interior point's result. By the implicit function theorem, a change of the program's data changes x and y by

    [ P   A'  ] [dx]     [ dP x + dq + dA'y ]
    [ A  -W^2 ] [dy] = - [ dA x - db        ],

with the Nesterov-Todd scaling W of the central pair (``augmented`` solves this system). The iterations are not
differentiated. By the envelope theorem, the optimal value changes as the Lagrangian does at fixed x and y.

Agrawal, Barratt, Boyd, Busseti and Moursi ("Differentiating through a cone program", 2019) differentiate the projection
onto the cone at the optimum, mu = 0. Both derivatives agree up to mu wherever the projection is differentiable. At a
weakly active constraint it is not; there the path's derivative lies between the two one-sided derivatives.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxscp.cones.product import ConeVector
from jaxscp.conic import conic_form
from jaxscp.conic.augmented import AugmentedSystem, Unknowns, factorise
from jaxscp.conic.central_path import centre, conditions, lagrangian
from jaxscp.conic.conic_form import Primal
from jaxscp.conic.equilibrate import scaled_by
from jaxscp.conic.interior_point import InteriorPoint, restored
from jaxscp.conic.program import ConicSolution, StagedProgram
from jaxscp.conic.smoothing import central_pair
from jaxscp.core.implicit import first_order_only, symmetric_solve
from jaxscp.core.status import Status
from jaxscp.core.trees import tree_axpy, tree_where
from jaxscp.core.types import Flag, Scalar

_SYSTEM_TOLERANCE = 1e-8  # relative residual below which a linear system counts as solved
_UNIQUENESS_TOLERANCE = (
    1e-6  # relative error of a known change of z, recovered from its product with the matrix
)


class LayerSolution(ConicSolution):
    """Solution whose ``z``, ``multipliers`` and ``objective`` have derivatives with respect to the program."""

    differentiable: Flag
    """Whether the point is on the central path and the optimum is unique to within rounding."""


class ConicLayer(eqx.Module):
    """Solver of a ``StagedProgram`` with derivatives in forward and reverse mode, under ``jit`` and ``vmap``.

    Derivatives exist with respect to every float of the program; for the mask ``links.soft`` they are zero. They are of
    first order: second derivatives raise a ``TypeError``. Only the symmetric part of the Hessian counts.

    If the program has no solution, or the iterations did not find one, ``z`` and ``multipliers`` are the interior
    point's, and derivatives are NaN. With weight zero they are zero, so that ``differentiable`` can mask batch
    elements.

    Derivatives are also NaN in directions, forward or reverse, in which the linear system has no accurate solution:
    along a face of many optima, and where redundant links would contradict each other. In other directions redundant
    links do no harm. The derivative of ``objective`` depends on the multipliers alone. If these are not unique, the
    derivative holds for changes after which the program still has a solution.

    Args:
        solver: the interior point that runs first.
        mu: slack times multiplier on the central path, in equilibrated units.
        tolerance: largest residual of the path's conditions, relative to the largest entry of q and b.
        steps: Newton steps allowed from the interior point's result to the path.

    Example:
        >>> import equinox as eqx, jax
        >>> from jaxscp.conic import ConicLayer
        >>> from jaxscp.conic.random_programs import smallest_program
        >>> program = smallest_program()
        >>> def cost(target):  # least effort from 0 to the target in one step: target^2 / 2
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
        """Solution of a program.

        Returns:
            A ``LayerSolution``. If ``differentiable``, its ``z`` and ``multipliers`` are the central point's, exact to
            about ``mu``; they may differ from the interior point's by the solver's tolerance. A central point
            has status ``converged``, even if the interior point ended early. Other statuses are the interior point's.
        """
        program = _with_symmetric_hessian(program)
        constant = jax.lax.stop_gradient(program)
        result = self.solver.iterate(constant)
        scales, scaled = result.scales, scaled_by(constant, result.scales)
        x, y, s = result.iterate.solution()
        point = centre(scaled, (x, tree_axpy(-1.0, y, s)), self.mu, self.tolerance, self.steps)
        is_optimum = point.error <= self.tolerance  # whatever ended the interior point
        status = Status.where(is_optimum, Status.converged, self.solver.status(result))
        # The matrix is finite even if it has no meaning, since zero times NaN would not be zero.
        pair = central_pair(jax.tree.map(lambda v: jnp.where(is_optimum, v, 1.0), point.t), self.mu)
        matrix = factorise(scaled, pair)
        x, y = tree_where(is_optimum, (point.x, pair.y), (x, y))
        cost = scales.cost * constant.objective(scales.columns * x.z)
        x, y, cost = _implicit_optimum(scaled_by(program, scales), (x, y, cost), matrix, is_optimum)
        z, multipliers = restored(scaled, scales, x, y)
        return LayerSolution(
            z,
            multipliers,
            cost / scales.cost,
            status,
            result.iterations,
            is_optimum & _is_unique(matrix),
        )


Optimum = tuple[Primal, ConeVector, Scalar]
"""(x, y, optimal value) in equilibrated units."""


@jax.custom_jvp
def _implicit_optimum(
    program: StagedProgram, optimum: Optimum, matrix: AugmentedSystem, is_optimum: Flag
) -> Optimum:
    """The given optimum, with derivatives by the implicit function theorem."""
    return optimum


@_implicit_optimum.defjvp
def _implicit_derivative(primals, tangents):
    from jaxopt import implicit_diff  # slow to import, and few programs ask for a derivative

    program, optimum, matrix, is_optimum = primals

    def residual(optimum, program):
        x, y, cost = optimum
        return *conditions(program, x, y, matrix.pair.s), cost - lagrangian(program, x, y)

    def solve(_, rhs):
        return _solve(matrix, is_optimum, rhs)

    return optimum, implicit_diff.root_jvp(
        residual, optimum, (first_order_only(program),), tangents[:1], solve=solve
    )


def _solve(matrix: AugmentedSystem, is_optimum: Flag, rhs: Optimum) -> Optimum:
    """Change of the optimum. The optimal value's equation is separate, but NaN together with the others."""
    dual, primal, cost = rhs
    dx, v, dcost = symmetric_solve(
        lambda u: (*matrix.times(u[:2]), u[2]),
        lambda u: (*_solve_or_nan(matrix, u[:2]), u[2]),
        (dual, matrix.scaled(primal), cost),
        is_optimum,
    )
    return dx, matrix.scaled(v), dcost


def _solve_or_nan(matrix: AugmentedSystem, rhs: Unknowns) -> Unknowns:
    """Solution of the linear system; NaN if the matrix is singular, or nearly so, in this direction."""
    solution, error = matrix.solve(rhs)
    return jax.tree.map(lambda v: jnp.where(error <= _SYSTEM_TOLERANCE, v, jnp.nan), solution)


def _is_unique(matrix: AugmentedSystem) -> Flag:
    """Whether the system recovers a change of z from the matrix times this change; false along a face of optima."""
    program = matrix.program
    z = (
        jnp.cos(jnp.arange(program.gradient.size))
        .astype(program.gradient.dtype)
        .reshape(program.gradient.shape)
    )
    zeros = jax.tree.map(
        jnp.zeros_like, (conic_form.linear_cost(program), conic_form.constraint_offset(program))
    )
    probe = eqx.tree_at(lambda u: u[0].z, zeros, z)
    (found, _), _ = matrix.solve(matrix.times(probe))
    return jnp.max(jnp.abs(found.z - z)) <= _UNIQUENESS_TOLERANCE


def _with_symmetric_hessian(program: StagedProgram) -> StagedProgram:
    """Program with the symmetric part of its Hessian, and ``links.soft`` as a constant."""
    hessian = 0.5 * (program.hessian + jnp.swapaxes(program.hessian, 1, 2))
    return eqx.tree_at(
        lambda p: (p.hessian, p.links.soft), program, (hessian, jax.lax.stop_gradient(program.links.soft))
    )
