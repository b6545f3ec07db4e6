"""Residuals of the homogeneous embedding, and the scalar measures that end the iteration."""

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxscp.cones import product
from jaxscp.cones.product import ConeVector
from jaxscp.conic import conic_form
from jaxscp.conic.conic_form import Primal
from jaxscp.conic.equilibrate import Scales
from jaxscp.conic.iterate import Iterate
from jaxscp.conic.program import StagedProgram
from jaxscp.core.trees import tree_axpy, tree_dot, tree_max
from jaxscp.core.types import Scalar


class Residuals(eqx.Module):
    """Residuals of the embedding's equations at an iterate, and measures of optimality and infeasibility."""

    x: Primal
    """P x + A'y + tau q."""
    y: ConeVector
    """A x + s - tau b."""
    tau: Scalar
    """q'x + b'y + kappa + x'P x / tau."""
    mu: Scalar
    """Mean complementarity (s'y + tau kappa) / (degree + 1)."""
    error: Scalar
    """Largest of relative gap, primal residual and dual residual."""
    infeasibility: Scalar
    """Residual of the certificate of infeasibility |A'y| / (-b'y); zero for an exact certificate."""
    unboundedness: Scalar
    """Residual of the certificate of unboundedness max(|P x|, |A x + s|) / (-q'x); zero for an exact one."""


def residuals_at(program: StagedProgram, scales: Scales, p: Iterate) -> Residuals:
    """Residuals and measures at an iterate."""
    q, b = conic_form.linear_cost(program), conic_form.constraint_offset(program)
    dual = tree_axpy(
        1.0, conic_form.times_hessian(program, p.x), conic_form.times_constraints_transpose(program, p.y)
    )
    primal = tree_axpy(1.0, p.s, conic_form.times_constraints(program, p.x))
    return with_measures(program, scales, p, tree_axpy(p.tau, q, dual), tree_axpy(-p.tau, b, primal))


def with_measures(
    program: StagedProgram, scales: Scales, p: Iterate, rx: Primal, ry: ConeVector
) -> Residuals:
    """Residuals rx = P x + A'y + tau q and ry = A x + s - tau b, with their measures."""
    q, b = conic_form.linear_cost(program), conic_form.constraint_offset(program)
    hessian_x = conic_form.times_hessian(program, p.x)
    dual = jax.tree.map(lambda r, a, d: r - a - p.tau * d, rx, hessian_x, q)
    primal = tree_axpy(p.tau, b, ry)
    quadratic, linear, offset = tree_dot(p.x, hessian_x), tree_dot(q, p.x), tree_dot(b, p.y)
    rtau = linear + offset + p.kappa + quadratic / p.tau
    mu = (tree_dot(p.s, p.y) + p.tau * p.kappa) / (product.degree(p.s) + 1)

    primal_cost = (0.5 * quadratic / p.tau + linear) / p.tau
    dual_cost = (-0.5 * quadratic / p.tau - offset) / p.tau
    # The gap is in the user's unit of cost, the residuals are in equilibrated units.
    gap = jnp.abs(primal_cost - dual_cost) / jnp.maximum(
        scales.cost, jnp.minimum(jnp.abs(primal_cost), jnp.abs(dual_cost))
    )
    primal_error = tree_max(ry) / (p.tau * jnp.maximum(1.0, tree_max(b)))
    dual_error = tree_max(rx) / (p.tau * jnp.maximum(1.0, tree_max(q)))

    infeasible = tree_max(dual) / jnp.maximum(-offset, 1e-300)
    unbounded = jnp.maximum(tree_max(hessian_x), tree_max(primal)) / jnp.maximum(-linear, 1e-300)
    return Residuals(
        rx, ry, rtau, mu, jnp.maximum(gap, jnp.maximum(primal_error, dual_error)), infeasible, unbounded
    )
