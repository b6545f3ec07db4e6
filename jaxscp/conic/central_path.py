"""A point of the central path of a staged program, by Newton's method from where the interior point stopped.

In the conic form min 1/2 x'Px + q'x, A x + s = b, s in K, the point at mu is where

    P x + q + A'y = 0,    A x + s = b,    s o y = mu e,

in the unknowns x and t = s - y, which leave the last equation nothing to ask (``smoothing``). An interior point's own
iterates are near the path, which is enough to follow it, but not for derivatives: off the path the Nesterov-Todd
scaling of a second-order cone is wrong across its axis by about as much as the pair is off.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxscp.cones.product import ConeVector
from jaxscp.conic import kkt
from jaxscp.conic.augmented import System, factorise
from jaxscp.conic.kkt import Primal
from jaxscp.conic.program import StagedProgram
from jaxscp.conic.smoothing import Pair, central_pair
from jaxscp.core.trees import tree_axpy, tree_dot, tree_max
from jaxscp.core.types import Scalar


class CentralPoint(eqx.Module):
    """Unknowns, and what they lack."""

    x: Primal
    gap: ConeVector
    error: Scalar
    """Largest residual of the conditions, relative to the largest entry of b and q."""
    steps: Int[Array, ""]


def conditions(program: StagedProgram, x: Primal, y: ConeVector, s: ConeVector) -> tuple[Primal, ConeVector]:
    """P x + q + A'y and A x + s - b: zero at the point."""
    dual = tree_axpy(1.0, kkt.times_hessian(program, x), kkt.linear_cost(program))
    primal = tree_axpy(-1.0, kkt.right_side(program), kkt.times_constraints(program, x))
    return tree_axpy(1.0, kkt.times_constraints_transpose(program, y), dual), tree_axpy(1.0, s, primal)


def lagrangian(program: StagedProgram, x: Primal, y: ConeVector) -> Scalar:
    """1/2 x'Px + q'x + y'(A x - b)."""
    gradient = tree_axpy(0.5, kkt.times_hessian(program, x), kkt.linear_cost(program))
    row = tree_axpy(-1.0, kkt.right_side(program), kkt.times_constraints(program, x))
    return tree_dot(gradient, x) + tree_dot(y, row)


def centre(
    program: StagedProgram, x: Primal, gap: ConeVector, mu: float, tolerance: float, steps: int
) -> CentralPoint:
    """Newton steps onto the path at mu, until the conditions hold to the tolerance or there have been too many."""
    size = jnp.maximum(1.0, tree_max((kkt.linear_cost(program), kkt.right_side(program))))

    def point(x, gap, count):
        pair = central_pair(gap, mu)
        return CentralPoint(x, gap, tree_max(conditions(program, x, pair.y, pair.s)) / size, count)

    def step(p: CentralPoint):
        return point(*_newton(program, p, central_pair(p.gap, mu)), p.steps + 1)

    return jax.lax.while_loop(
        lambda p: (p.error > tolerance) & (p.steps < steps), step, point(x, gap, jnp.zeros((), int))
    )


def _newton(program: StagedProgram, p: CentralPoint, pair: Pair) -> tuple[Primal, ConeVector]:
    matrix: System = factorise(program, pair)
    dual, primal = conditions(program, p.x, pair.y, pair.s)
    (dx, v), _ = matrix.solve((dual, matrix.scaled(primal)))
    # dt = ds - dy with ds from its own equation: exact also where I - D is nearly singular
    ds = tree_axpy(-1.0, kkt.times_constraints(program, dx), primal)
    dgap = tree_axpy(-1.0, matrix.scaled(v), ds)
    return tree_axpy(-1.0, dx, p.x), tree_axpy(-1.0, dgap, p.gap)
