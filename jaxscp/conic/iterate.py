"""Iterates of the interior point, and the two starting points."""

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxscp.cones import product
from jaxscp.cones.product import ConeVector
from jaxscp.conic import conic_form, kkt
from jaxscp.conic.conic_form import Primal
from jaxscp.conic.program import StagedProgram, WarmStart
from jaxscp.conic.warm_start import central_start
from jaxscp.core.trees import tree_negated
from jaxscp.core.types import Scalar


class Iterate(eqx.Module):
    """Point (x, y, s, tau, kappa) of the homogeneous embedding; with tau = 1 and kappa = 0, of the program."""

    x: Primal
    """Variables."""
    y: ConeVector
    """Multipliers."""
    s: ConeVector
    """Slacks."""
    tau: Scalar
    kappa: Scalar

    def solution(self) -> tuple[Primal, ConeVector, ConeVector]:
        """Variables x / tau, multipliers y / tau and slacks s / tau of the program."""
        tau = jnp.maximum(self.tau, 1e-12)
        return jax.tree.map(lambda v: v / tau, (self.x, self.y, self.s))

    @classmethod
    def from_least_squares(cls, program: StagedProgram, regularisation: float, refinements: int) -> "Iterate":
        """Cold start: solution of the program with the cones replaced by a least-squares penalty on s."""
        identity = product.identity(conic_form.constraint_offset(program))
        scaling = product.scaling(identity, identity)
        factor = kkt.factorise(program, scaling, regularisation)
        q, b = conic_form.linear_cost(program), conic_form.constraint_offset(program)
        x, y = kkt.solve(program, scaling, factor, tree_negated(q), b, refinements)
        slack = eqx.tree_at(lambda v: v.zero, tree_negated(y), jnp.zeros_like(y.zero))
        slack = product.lift_inside(slack)
        # The bounds of the norms equal the heads of their cones, so that these rows start without residual.
        _, trust, virtual = conic_form.unpack_cones(program, slack.second)
        x = Primal(x.z, trust[:, 0], virtual[:, 0])
        return cls(x, product.lift_inside(y), slack, jnp.ones(()), jnp.ones(()))

    @classmethod
    def from_warm_start(cls, program: StagedProgram, warm_start: WarmStart) -> "Iterate":
        """Start on the central path near an estimate of the solution, with tau = 1 and kappa = 0."""
        x, y, s = central_start(program, warm_start)
        return cls(x, y, s, jnp.ones(()), jnp.zeros(()))
