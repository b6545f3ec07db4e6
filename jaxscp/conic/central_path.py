"""Point on the central path of a staged program, by Newton's method from the interior point's result.

In conic form, min 1/2 x'Px + q'x, A x + s = b, s in K, the central point at mu satisfies

    P x + q + A'y = 0,    A x + s = b,    s o y = mu e.

The unknowns are x and t = s - y, for which the last equation holds identically (``smoothing``). The interior point's
own iterates are close to the path, but not close enough for derivatives: away from the path, the Nesterov-Todd scaling
of a second-order cone has an error across the cone's axis of about the distance from the path.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxscp.cones.product import ConeVector
from jaxscp.conic import conic_form
from jaxscp.conic.augmented import AugmentedSystem, factorise
from jaxscp.conic.conic_form import Primal
from jaxscp.conic.program import StagedProgram
from jaxscp.conic.smoothing import CentralPair, central_pair
from jaxscp.core.trees import tree_axpy, tree_dot, tree_max
from jaxscp.core.types import Scalar


class CentralPoint(eqx.Module):
    """Unknowns of the central path's conditions, and their residual."""

    x: Primal
    t: ConeVector
    """s - y."""
    error: Scalar
    """Largest residual of the conditions, relative to the largest entry of b and q."""
    steps: Int[Array, ""]


def conditions(program: StagedProgram, x: Primal, y: ConeVector, s: ConeVector) -> tuple[Primal, ConeVector]:
    """Residuals P x + q + A'y and A x + s - b."""
    dual = tree_axpy(1.0, conic_form.times_hessian(program, x), conic_form.linear_cost(program))
    primal = tree_axpy(-1.0, conic_form.constraint_offset(program), conic_form.times_constraints(program, x))
    return (
        tree_axpy(1.0, conic_form.times_constraints_transpose(program, y), dual),
        tree_axpy(1.0, s, primal),
    )


def lagrangian(program: StagedProgram, x: Primal, y: ConeVector) -> Scalar:
    """1/2 x'Px + q'x + y'(A x - b)."""
    gradient = tree_axpy(0.5, conic_form.times_hessian(program, x), conic_form.linear_cost(program))
    row = tree_axpy(-1.0, conic_form.constraint_offset(program), conic_form.times_constraints(program, x))
    return tree_dot(gradient, x) + tree_dot(y, row)


def centre(
    program: StagedProgram, start: tuple[Primal, ConeVector], mu: float, tolerance: float, max_steps: int
) -> CentralPoint:
    """Central point at mu, by Newton steps from (x, t) until the error is below the tolerance."""
    size = jnp.maximum(
        1.0, tree_max((conic_form.linear_cost(program), conic_form.constraint_offset(program)))
    )

    def point(x, t, count):
        pair = central_pair(t, mu)
        return CentralPoint(x, t, tree_max(conditions(program, x, pair.y, pair.s)) / size, count)

    def step(p: CentralPoint):
        return point(*_newton(program, p, central_pair(p.t, mu)), p.steps + 1)

    return jax.lax.while_loop(
        lambda p: (p.error > tolerance) & (p.steps < max_steps), step, point(*start, jnp.zeros((), int))
    )


def _newton(program: StagedProgram, p: CentralPoint, pair: CentralPair) -> tuple[Primal, ConeVector]:
    """(x, t) after one Newton step."""
    matrix: AugmentedSystem = factorise(program, pair)
    dual, primal = conditions(program, p.x, pair.y, pair.s)
    (dx, v), _ = matrix.solve((dual, matrix.scaled(primal)))
    # dt = ds - dy, with ds from its own equation, which is accurate also if I - D is nearly singular.
    ds = tree_axpy(-1.0, conic_form.times_constraints(program, dx), primal)
    dt = tree_axpy(-1.0, matrix.scaled(v), ds)
    return tree_axpy(-1.0, dx, p.x), tree_axpy(-1.0, dt, p.t)
