"""Newton directions of the interior point at one iterate, and how far to go along them.

Mehrotra's predictor and corrector, of the program itself and of the homogeneous embedding (``interior_point``).
"""

import jax
import jax.numpy as jnp

from jaxscp.cones import product
from jaxscp.cones.product import ConeVector
from jaxscp.conic import kkt
from jaxscp.conic.iterate import Iterate, Residuals
from jaxscp.conic.kkt import Primal
from jaxscp.conic.program import StagedProgram
from jaxscp.core.trees import tree_axpy, tree_dot, tree_negated
from jaxscp.core.types import Count, Flag, Scalar


class Newton:
    """Newton directions of the program at one iterate, and how far to go along them."""

    part = 0.98  # of the way to the boundary
    surely = 0.8  # of a tolerance, of what is expected

    def __init__(
        self, program: StagedProgram, iterate: Iterate, regularisation: float, refinements: Count | int
    ):
        self.program, self.iterate = program, iterate
        self.scaling = product.scaling(iterate.s, iterate.y)
        factor = kkt.factorise(program, self.scaling, regularisation)
        self._solve = lambda rx, ry: kkt.solve(program, self.scaling, factor, rx, ry, refinements)

    def predictor(self, r: Residuals) -> Iterate:
        """The affine direction, which aims at s = 0."""
        solution = self._solve_affine(self._right_side(r, 1.0, self.iterate.s))
        return self._direction(r, 1.0, self.iterate.tau * self.iterate.kappa, solution, self.iterate.s)

    def corrector(self, r: Residuals, affine: Iterate, sigma: Scalar) -> Iterate:
        """Mehrotra's combined direction: centring by sigma and second-order correction."""
        cross = product.product(self.scaling.apply_inverse(affine.s), self.scaling.apply(affine.y))
        target = tree_axpy(-sigma * r.mu, product.identity(affine.s), cross)
        target_tau = self.iterate.tau * self.iterate.kappa + affine.tau * affine.kappa - sigma * r.mu
        lifted = self.scaling.apply(product.divide(self.scaling.apply(self.iterate.y), target))
        lifted = tree_axpy(1.0, lifted, self.iterate.s)
        solution = self._solve(*self._right_side(r, 1.0 - sigma, lifted))
        return self._direction(r, 1.0 - sigma, target_tau, solution, lifted)

    def longest_steps(self, direction: Iterate) -> tuple[Scalar, Scalar]:
        """How far it stays in the cones, at most one: with variables and slacks, and with multipliers. Of a linear
        program the multipliers' residuals do not depend on the variables, and both go as far as they can."""
        point = self.iterate
        primal = jnp.minimum(1.0, product.longest_step(point.s, direction.s))
        dual = jnp.minimum(1.0, product.longest_step(point.y, direction.y))
        both, linear = jnp.minimum(primal, dual), jnp.all(self.program.hessian == 0.0)
        return jnp.where(linear, primal, both), jnp.where(linear, dual, both)

    def centring(self, affine: Iterate) -> Scalar:
        """Mehrotra's share of the complementarity to aim at: the cube of what the affine direction leaves of it."""
        return jnp.clip(self._left_of(affine, *self.longest_steps(affine)), 0.0, 1.0) ** 3

    def suffices(self, r: Residuals, affine: Iterate, tolerance: Scalar) -> Flag:
        """Whether nothing is left to correct: with the part of the affine direction that can be taken the program is
        solved."""
        primal, dual = (self.part * length for length in self.longest_steps(affine))
        left = jnp.maximum(self._left_of(affine, primal, dual), 1.0 - jnp.minimum(primal, dual))
        return r.error * left <= self.surely * tolerance

    def _left_of(self, affine: Iterate, primal: Scalar, dual: Scalar) -> Scalar:
        """Share of the complementarity that steps of these lengths leave."""
        s, y = tree_axpy(primal, affine.s, self.iterate.s), tree_axpy(dual, affine.y, self.iterate.y)
        return tree_dot(s, y) / tree_dot(self.iterate.s, self.iterate.y)

    def _solve_affine(self, right_side: tuple[Primal, ConeVector]) -> tuple[Primal, ConeVector]:
        return self._solve(*right_side)

    def _right_side(
        self, r: Residuals, share: Scalar | float, lifted: ConeVector
    ) -> tuple[Primal, ConeVector]:
        """Residuals reduced by ``share``, slacks moved by ``-lifted``."""
        return jax.tree.map(lambda v: -share * v, r.x), tree_axpy(-share, r.y, lifted)

    def _direction(self, r: Residuals, share, target_tau, solution, lifted: ConeVector) -> Iterate:
        """With the slacks that follow."""
        dx, dy, dtau, dkappa = self._embed(r, share, target_tau, *solution)
        return Iterate(dx, dy, tree_negated(tree_axpy(1.0, lifted, self.scaling.square(dy))), dtau, dkappa)

    def _embed(self, r: Residuals, share, target_tau, x: Primal, y: ConeVector):
        """A solution as it is, where tau is one."""
        return x, y, jnp.zeros(()), jnp.zeros(())


class Embedded(Newton):
    """Newton directions of the embedding."""

    part = 0.99

    def longest_steps(self, direction: Iterate) -> tuple[Scalar, Scalar]:
        """One for both, which keeps tau and kappa positive too: residuals are in proportion to tau."""
        point = self.iterate
        scalars = _before_zero(point.tau, direction.tau), _before_zero(point.kappa, direction.kappa)
        step = jnp.min(jnp.stack([*super().longest_steps(direction), *scalars]))
        return step, step

    def centring(self, affine: Iterate) -> Scalar:
        """That of all residuals, in proportion to tau: the cube of what the affine direction leaves of them."""
        step, _ = self.longest_steps(affine)
        return (1.0 - step) ** 3

    def suffices(self, r: Residuals, affine: Iterate, tolerance: Scalar) -> Flag:
        """Never: from afar the correction is what keeps the way open."""
        return jnp.zeros((), bool)

    def _solve_affine(self, right_side: tuple[Primal, ConeVector]) -> tuple[Primal, ConeVector]:
        """Together with the constant direction, which both steps share."""
        self.q, self.b = kkt.linear_cost(self.program), kkt.right_side(self.program)
        self.xi = jax.tree.map(lambda v: v / self.iterate.tau, self.iterate.x)
        self.gradient = tree_axpy(2.0, kkt.times_hessian(self.program, self.xi), self.q)
        both = jax.tree.map(lambda u, v: jnp.stack([u, v]), (tree_negated(self.q), self.b), right_side)
        both = jax.vmap(self._solve)(*both)
        self.constant, solution = (jax.tree.map(lambda v, i=i: v[i], both) for i in range(2))
        self.slope = self._slope()
        return solution

    def _embed(self, r: Residuals, share, target_tau, x: Primal, y: ConeVector):
        """With the multiple of the constant direction that the embedding's last equation asks for."""
        tau, kappa = self.iterate.tau, self.iterate.kappa
        defect = -share * r.tau + target_tau / tau - tree_dot(self.gradient, x) - tree_dot(self.b, y)
        dtau = defect / self.slope
        dx, dy = tree_axpy(dtau, self.constant[0], x), tree_axpy(dtau, self.constant[1], y)
        return dx, dy, dtau, -(target_tau + kappa * dtau) / tau

    def _slope(self) -> Scalar:
        """Derivative of the embedding's last equation along the constant direction; always negative."""
        x, y = self.constant
        apart = tree_axpy(-1.0, self.xi, x)
        curvature = tree_dot(apart, kkt.times_hessian(self.program, apart))
        spread = tree_dot(y, self.scaling.square(y))
        return -(curvature + spread + self.iterate.kappa / self.iterate.tau)


def _before_zero(value: Scalar, change: Scalar) -> Scalar:
    """The step at which a positive number is zero."""
    return jnp.where(change < 0, -value / change, jnp.inf)
