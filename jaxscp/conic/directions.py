"""Newton directions of the interior point at one iterate, and the step lengths along them.

Mehrotra's predictor and corrector, for the program itself and for the homogeneous embedding (``interior_point``).
Each direction reduces the residuals to a fraction, and the slacks follow from the multipliers:

    [ P   A'  ] [dx]     [ (1 - sigma) rx            ]
    [ A  -W^2 ] [dy] = - [ (1 - sigma) ry - slack    ],      ds = -(slack + W^2 dy),

where slack is the right-hand side of the complementarity equation in units of s.
"""

import jax
import jax.numpy as jnp

from jaxscp.cones import product
from jaxscp.cones.product import ConeVector
from jaxscp.conic import conic_form, kkt
from jaxscp.conic.conic_form import Primal
from jaxscp.conic.iterate import Iterate
from jaxscp.conic.program import StagedProgram
from jaxscp.conic.residuals import Residuals
from jaxscp.core.trees import tree_axpy, tree_dot, tree_negated
from jaxscp.core.types import Count, Flag, Scalar


class Newton:
    """Newton directions of the program itself at one iterate (tau = 1, kappa = 0)."""

    step_fraction = 0.98
    """Fraction of the step to the boundary that is taken."""
    safety = 0.8
    """Fraction of the tolerance that the predicted error must meet before the corrector is skipped."""

    def __init__(
        self, program: StagedProgram, iterate: Iterate, regularisation: float, refinements: Count | int
    ):
        self.program, self.iterate = program, iterate
        self.scaling = product.scaling(iterate.s, iterate.y)
        factor = kkt.factorise(program, self.scaling, regularisation)
        self._solve = lambda rx, ry: kkt.solve(program, self.scaling, factor, rx, ry, refinements)

    def predictor(self, r: Residuals) -> Iterate:
        """Affine direction, which aims at s o y = 0."""
        solution = self._solve_affine(self._rhs(r, 1.0, self.iterate.s))
        return self._direction(r, 1.0, self.iterate.tau * self.iterate.kappa, solution, self.iterate.s)

    def corrector(self, r: Residuals, affine: Iterate, sigma: Scalar) -> Iterate:
        """Mehrotra's combined direction: centring by sigma and second-order correction."""
        cross = product.product(self.scaling.apply_inverse(affine.s), self.scaling.apply(affine.y))
        target = tree_axpy(-sigma * r.mu, product.identity(affine.s), cross)
        target_tau = self.iterate.tau * self.iterate.kappa + affine.tau * affine.kappa - sigma * r.mu
        slack = self.scaling.apply(product.divide(self.scaling.apply(self.iterate.y), target))
        slack = tree_axpy(1.0, slack, self.iterate.s)
        solution = self._solve(*self._rhs(r, 1.0 - sigma, slack))
        return self._direction(r, 1.0 - sigma, target_tau, solution, slack)

    def longest_steps(self, direction: Iterate) -> tuple[Scalar, Scalar]:
        """Largest steps in the cones, at most one: for variables and slacks, and for multipliers.

        In a linear program the dual residual does not depend on the variables, so that the two steps may differ.
        """
        point = self.iterate
        primal = jnp.minimum(1.0, product.longest_step(point.s, direction.s))
        dual = jnp.minimum(1.0, product.longest_step(point.y, direction.y))
        both, linear = jnp.minimum(primal, dual), jnp.all(self.program.hessian == 0.0)
        return jnp.where(linear, primal, both), jnp.where(linear, dual, both)

    def centring(self, affine: Iterate) -> Scalar:
        """Mehrotra's sigma: cube of the fraction of complementarity that remains after the affine step."""
        return jnp.clip(self._remaining(affine, *self.longest_steps(affine)), 0.0, 1.0) ** 3

    def suffices(self, r: Residuals, affine: Iterate, tolerance: Scalar) -> Flag:
        """Whether the affine step alone is predicted to solve the program, so that no corrector is needed."""
        primal, dual = (self.step_fraction * length for length in self.longest_steps(affine))
        remaining = jnp.maximum(self._remaining(affine, primal, dual), 1.0 - jnp.minimum(primal, dual))
        return r.error * remaining <= self.safety * tolerance

    def _remaining(self, affine: Iterate, primal: Scalar, dual: Scalar) -> Scalar:
        """Fraction of the complementarity s'y that remains after steps of these lengths."""
        s, y = tree_axpy(primal, affine.s, self.iterate.s), tree_axpy(dual, affine.y, self.iterate.y)
        return tree_dot(s, y) / tree_dot(self.iterate.s, self.iterate.y)

    def _solve_affine(self, rhs: tuple[Primal, ConeVector]) -> tuple[Primal, ConeVector]:
        """(dx, dy) of the affine direction."""
        return self._solve(*rhs)

    def _rhs(self, r: Residuals, fraction: Scalar | float, slack: ConeVector) -> tuple[Primal, ConeVector]:
        """(-fraction rx, slack - fraction ry)."""
        return jax.tree.map(lambda v: -fraction * v, r.x), tree_axpy(-fraction, r.y, slack)

    def _direction(self, r: Residuals, fraction, target_tau, solution, slack: ConeVector) -> Iterate:
        """Direction from a solution (dx, dy), with ds = -(slack + W^2 dy)."""
        dx, dy, dtau, dkappa = self._embed(r, fraction, target_tau, *solution)
        return Iterate(dx, dy, tree_negated(tree_axpy(1.0, slack, self.scaling.square(dy))), dtau, dkappa)

    def _embed(self, r: Residuals, fraction, target_tau, x: Primal, y: ConeVector):
        """(dx, dy, dtau, dkappa), where tau and kappa are constant."""
        return x, y, jnp.zeros(()), jnp.zeros(())


class Embedded(Newton):
    """Newton directions of the homogeneous embedding at one iterate."""

    step_fraction = 0.99

    def longest_steps(self, direction: Iterate) -> tuple[Scalar, Scalar]:
        """One step length for all variables; tau and kappa remain positive too."""
        point = self.iterate
        scalars = _step_to_zero(point.tau, direction.tau), _step_to_zero(point.kappa, direction.kappa)
        step = jnp.min(jnp.stack([*super().longest_steps(direction), *scalars]))
        return step, step

    def centring(self, affine: Iterate) -> Scalar:
        """Mehrotra's sigma: cube of the fraction of all residuals that remains after the affine step."""
        step, _ = self.longest_steps(affine)
        return (1.0 - step) ** 3

    def suffices(self, r: Residuals, affine: Iterate, tolerance: Scalar) -> Flag:
        """False: far from the solution, centring keeps the next steps long."""
        return jnp.zeros((), bool)

    def _solve_affine(self, rhs: tuple[Primal, ConeVector]) -> tuple[Primal, ConeVector]:
        """(dx, dy) of the affine direction; also solves for the constant direction, with right-hand side (-q, b)."""
        self.q, self.b = conic_form.linear_cost(self.program), conic_form.constraint_offset(self.program)
        self.xi = jax.tree.map(lambda v: v / self.iterate.tau, self.iterate.x)
        self.gradient = tree_axpy(2.0, conic_form.times_hessian(self.program, self.xi), self.q)
        both = jax.tree.map(lambda u, v: jnp.stack([u, v]), (tree_negated(self.q), self.b), rhs)
        both = jax.vmap(self._solve)(*both)
        self.constant, solution = (jax.tree.map(lambda v, i=i: v[i], both) for i in range(2))
        self.slope = self._slope()
        return solution

    def _embed(self, r: Residuals, fraction, target_tau, x: Primal, y: ConeVector):
        """(dx, dy, dtau, dkappa): adds dtau times the constant direction, dtau from the equation of tau."""
        tau, kappa = self.iterate.tau, self.iterate.kappa
        defect = -fraction * r.tau + target_tau / tau - tree_dot(self.gradient, x) - tree_dot(self.b, y)
        dtau = defect / self.slope
        dx, dy = tree_axpy(dtau, self.constant[0], x), tree_axpy(dtau, self.constant[1], y)
        return dx, dy, dtau, -(target_tau + kappa * dtau) / tau

    def _slope(self) -> Scalar:
        """Derivative of the equation of tau along the constant direction; always negative."""
        x, y = self.constant
        difference = tree_axpy(-1.0, self.xi, x)
        curvature = tree_dot(difference, conic_form.times_hessian(self.program, difference))
        spread = tree_dot(y, self.scaling.square(y))
        return -(curvature + spread + self.iterate.kappa / self.iterate.tau)


def _step_to_zero(value: Scalar, change: Scalar) -> Scalar:
    """Step at which a positive number reaches zero; infinity if the number does not decrease."""
    return jnp.where(change < 0, -value / change, jnp.inf)
