"""An iterate of the interior point, and what it lacks."""

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxscp.cones import product
from jaxscp.cones.product import ConeVector
from jaxscp.conic import kkt
from jaxscp.conic.equilibrate import Scales
from jaxscp.conic.kkt import Primal
from jaxscp.conic.program import StagedProgram, WarmStart
from jaxscp.conic.warm_start import central_start
from jaxscp.core.trees import tree_axpy, tree_dot, tree_max
from jaxscp.core.types import Scalar


class Iterate(eqx.Module):
    """A point of the homogeneous embedding; of the program itself where tau is one and kappa zero."""

    x: Primal
    y: ConeVector
    s: ConeVector
    tau: Scalar
    kappa: Scalar

    def solution(self) -> tuple[Primal, ConeVector, ConeVector]:
        """Variables, multipliers and slacks of the program itself, where it is solved."""
        tau = jnp.maximum(self.tau, 1e-12)
        return jax.tree.map(lambda v: v / tau, (self.x, self.y, self.s))

    @classmethod
    def near(cls, program: StagedProgram, near: WarmStart) -> "Iterate":
        """The start near a point that is thought to be not far from the solution."""
        x, y, s = central_start(program, near)
        return cls(x, y, s, jnp.ones(()), jnp.zeros(()))


class Residuals(eqx.Module):
    """What the embedding's equations lack, and the measures that end the iteration."""

    x: Primal
    y: ConeVector
    tau: Scalar
    mu: Scalar
    error: Scalar
    """Largest of relative gap, primal and dual residual."""
    infeasibility: Scalar
    """How well the iterate proves infeasibility; a proof at zero."""
    unboundedness: Scalar
    """How well the iterate proves unboundedness; a proof at zero."""


def residuals_at(program: StagedProgram, scales: Scales, p: Iterate) -> Residuals:
    """What is missing at an iterate."""
    q, b = kkt.linear_cost(program), kkt.right_side(program)
    dual = tree_axpy(1.0, kkt.times_hessian(program, p.x), kkt.times_constraints_transpose(program, p.y))
    primal = tree_axpy(1.0, p.s, kkt.times_constraints(program, p.x))
    return measured(program, scales, p, tree_axpy(p.tau, q, dual), tree_axpy(-p.tau, b, primal))


def measured(program: StagedProgram, scales: Scales, p: Iterate, rx: Primal, ry: ConeVector) -> Residuals:
    """Of P x + A'y + tau q and A x + s - tau b, the measures."""
    q, b = kkt.linear_cost(program), kkt.right_side(program)
    hessian_x = kkt.times_hessian(program, p.x)
    dual = jax.tree.map(lambda r, a, d: r - a - p.tau * d, rx, hessian_x, q)
    primal = tree_axpy(p.tau, b, ry)
    quadratic, linear, offset = tree_dot(p.x, hessian_x), tree_dot(q, p.x), tree_dot(b, p.y)
    rtau = linear + offset + p.kappa + quadratic / p.tau
    mu = (tree_dot(p.s, p.y) + p.tau * p.kappa) / (product.degree(p.s) + 1)

    primal_cost = (0.5 * quadratic / p.tau + linear) / p.tau
    dual_cost = (-0.5 * quadratic / p.tau - offset) / p.tau
    # The gap is judged in the user's unit of cost, the residuals in equilibrated units.
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
