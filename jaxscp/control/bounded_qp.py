"""Quadratic programs over controls at nodes, with bounds on the controls and on their changes.

    minimise  1/2 v' H v + g' v   subject to   lower <= (v_k, v_k - v_{k-1}) <= upper,   k = 1..N,  v_0 given

A primal-dual interior point with Mehrotra's predictor and corrector ("On the implementation of a primal-dual interior
point method", 1992). A limit of the steps bounds the time of a call. Reverse mode works. Iterates start
inside all limits and stay there, so that every iterate may be applied.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Bool, Float

from jaxscp.core.types import Scalar

TO_BOUNDARY = 0.995  # of the step to the nearest limit, and of a full step
INTERIOR = 0.7  # of the way to the guess, and of the way from the centre to the nearest limit
LEAST_SLACK = 1e-12  # of numbers of order one
LEAST_MU = 1e-14  # of the gradient's size: the least complementarity that is asked for
EXACT = 1e-13
FIRST_MU = 0.1  # of the gradient's size: multiplier times slack at the start

Controls = Float[Array, "nodes controls"]
Rows = Float[Array, "2 nodes controls"]
"""Controls, and their changes."""
Sides = Float[Array, "2 2 nodes controls"]
"""Lower and upper side of every row."""


class BoundedQP(eqx.Module):
    """The program."""

    hessian: Float[Array, "variables variables"]
    """H, of the controls of all nodes one after the other; positive definite."""
    gradient: Controls
    """g"""
    before: Float[Array, "controls"]
    """v_0"""
    lower: Rows
    """Limits may be infinite."""
    upper: Rows

    def rows(self, v: Controls) -> Rows:
        """Controls and their changes."""
        return _rows(v).at[1, 0].add(-self.before)

    def slack(self, v: Controls) -> Sides:
        """Distances from the limits; one where there is no limit. Rounding makes none of them zero."""
        rows = self.rows(v)
        distances = jnp.stack([rows - self.lower, self.upper - rows])
        return jnp.where(self.limited(), jnp.maximum(distances, LEAST_SLACK), 1.0)

    def limited(self) -> Bool[Array, "2 2 nodes controls"]:
        """Whether there is a limit."""
        return jnp.isfinite(jnp.stack([self.lower, self.upper]))

    def stationarity(self, v: Controls, multipliers: Sides) -> Controls:
        """Gradient of the Lagrangian."""
        product = (self.hessian @ v.ravel()).reshape(v.shape)
        return product + self.gradient - _transposed_rows(multipliers[0] - multipliers[1])


class QPSolution(eqx.Module):
    """Last iterate of the interior point."""

    v: Controls
    """Within all limits."""
    multipliers: Sides
    residual: Scalar
    """Largest component of the Lagrangian's gradient, relative to the cost's gradient."""
    complementarity: Scalar
    """Mean of multiplier times slack, relative to the cost's gradient."""


def solve(
    qp: BoundedQP, guess: Controls, centre: Controls, iterations: int, tolerance: float = EXACT
) -> QPSolution:
    """Solution by at most so many interior-point steps.

    Args:
        qp: the program.
        guess: controls, within the limits or not.
        centre: controls strictly inside all limits.
        iterations: most interior-point steps.
        tolerance: relative residual and complementarity at which the steps end.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.control.bounded_qp import BoundedQP, solve
        >>> limits = jnp.array([[[3.0]], [[jnp.inf]]])  # |v| <= 3
        >>> qp = BoundedQP(jnp.eye(1), jnp.array([[-5.0]]), jnp.zeros(1), -limits, limits)
        >>> solve(qp, jnp.zeros((1, 1)), jnp.zeros((1, 1)), iterations=12).v.round(6).tolist()
        [[3.0]]
    """
    limited = qp.limited()
    count = jnp.maximum(jnp.sum(limited), 1).astype(qp.gradient.dtype)
    v = _inside(qp, guess, centre)
    cost_gradient = (qp.hessian @ v.ravel()).reshape(v.shape) + qp.gradient
    scale = jnp.maximum(jnp.max(jnp.abs(cost_gradient)), 1e-6)
    slack = qp.slack(v)
    multipliers = jnp.where(limited, FIRST_MU * scale / slack, 0.0)

    def step(iterate, _):
        v, multipliers = iterate
        residual, complementarity = _relative(qp, v, multipliers, count, scale)
        # beyond this slacks are rounding errors
        ended = (residual <= tolerance) & (complementarity <= jnp.maximum(tolerance, LEAST_MU))
        # reverse mode works through a scan, but not through a loop that ends early
        newton = lambda v, multipliers: _mehrotra_step(qp, limited, count, v, multipliers)  # noqa: E731
        return jax.lax.cond(ended, lambda *same: same, newton, v, multipliers), None

    (v, multipliers), _ = jax.lax.scan(step, (v, multipliers), None, length=iterations)
    return QPSolution(v, multipliers, *_relative(qp, v, multipliers, count, scale))


def _relative(qp: BoundedQP, v: Controls, multipliers: Sides, count: Scalar, scale: Scalar):
    """Residual and complementarity, relative to the cost's gradient."""
    residual = jnp.max(jnp.abs(qp.stationarity(v, multipliers))) / scale
    return residual, jnp.sum(multipliers * qp.slack(v)) / (count * scale)


def _mehrotra_step(qp: BoundedQP, limited: Array, count: Scalar, v: Controls, multipliers: Sides):
    """The next controls and multipliers."""
    slack = qp.slack(v)
    ratio = multipliers / slack
    factor = jnp.linalg.cholesky(qp.hessian + _weighted_gram(ratio[0] + ratio[1]), symmetrize_input=False)
    stationarity = qp.stationarity(v, multipliers)
    mu = jnp.sum(multipliers * slack) / count

    def direction(complementarity: Sides):
        """Newton's direction towards products of multiplier and slack that are smaller by so much."""
        correction = complementarity / slack
        right = -stationarity - _transposed_rows(correction[0] - correction[1])
        dv = cho_solve((factor, True), right.ravel()).reshape(v.shape)
        drows = _rows(dv)
        dslack = jnp.where(limited, jnp.stack([drows, -drows]), 0.0)
        return dv, dslack, jnp.where(limited, -correction - ratio * dslack, 0.0)

    _, dslack, dmultipliers = direction(multipliers * slack)
    length = _step_length(slack, dslack, multipliers, dmultipliers)
    products = (slack + length * dslack) * (multipliers + length * dmultipliers)
    affine = jnp.sum(jnp.where(limited, products, 0.0)) / count
    centring = mu * (affine / jnp.where(mu > 0.0, mu, 1.0)) ** 3
    target = multipliers * slack + dslack * dmultipliers - centring
    dv, dslack, dmultipliers = direction(jnp.where(limited, target, 0.0))
    # one length for both: else a quadratic cost's residual would not shrink with the step
    length = TO_BOUNDARY * _step_length(slack, dslack, multipliers, dmultipliers)
    return v + length * dv, multipliers + length * dmultipliers


def _inside(qp: BoundedQP, guess: Controls, centre: Controls) -> Controls:
    """A point strictly inside all limits, towards the guess."""
    change = _rows(guess - centre)
    dslack = jnp.where(qp.limited(), jnp.stack([change, -change]), 0.0)
    return centre + INTERIOR * _largest_step(qp.slack(centre), dslack) * (guess - centre)


def _step_length(slack: Sides, dslack: Sides, multipliers: Sides, dmultipliers: Sides) -> Scalar:
    """Largest step at which slacks and multipliers stay positive, at most one."""
    return jnp.minimum(_largest_step(slack, dslack), _largest_step(multipliers, dmultipliers))


def _largest_step(values: Sides, change: Sides) -> Scalar:
    falling = change < 0.0
    return jnp.min(jnp.where(falling, values / jnp.where(falling, -change, 1.0), 1.0), initial=1.0)


def _rows(v: Controls) -> Rows:
    """Controls and their changes, from zero on."""
    return jnp.stack([v, jnp.diff(v, axis=0, prepend=jnp.zeros_like(v[:1]))])


def _transposed_rows(y: Rows) -> Controls:
    """The adjoint of ``_rows``."""
    return y[0] - jnp.diff(y[1], axis=0, append=jnp.zeros_like(y[1, :1]))


def _weighted_gram(weights: Rows) -> Float[Array, "variables variables"]:
    """C' diag(weights) C with C the matrix of ``_rows``: tridiagonal for each control."""
    nodes, controls = weights.shape[1:]
    after = jnp.concatenate([weights[1, 1:], jnp.zeros_like(weights[1, :1])])
    eye, above, below = (jnp.eye(nodes, k=k, dtype=weights.dtype)[:, :, None] for k in (0, 1, -1))
    blocks = eye * (weights[0] + weights[1] + after) - above * after[:, None] - below * after
    of_controls = jnp.eye(controls, dtype=weights.dtype)[None, :, None, :]
    return (blocks[:, None] * of_controls).reshape(nodes * controls, -1)
