"""A Newton direction of the interior point, and the inertia correction that makes its matrix definite."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.linalg import riccati
from jaxscp.nlp.newton_system import (
    EliminatedInequalities,
    Scalings,
    SecondOrderModel,
    eliminate_inequalities,
    jacobian_product,
    scaled,
    scalings,
)
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.inequalities import Values, cones

# Corrections of the diagonal, where the matrix is indefinite. One that is much larger than needed makes small steps
# along directions of negative curvature: the iterates leave a saddle slowly.
FIRST_CORRECTION, LEAST_CORRECTION, MOST_CORRECTION = 1e-4, 1e-9, 1e4
SHRINKAGE, GROWTH = 3.0, 8.0  # from one iterate to the next, and from one trial to the next


class Pairs(eqx.Module):
    """The slacks and multipliers of all inequalities at an iterate."""

    slack: Values
    multipliers: Values
    scalings: Scalings
    """W."""
    barrier_gradients: Values
    """Of the slacks."""
    eliminated: EliminatedInequalities
    """With J' times multipliers, barrier gradients and scaled slack residuals W^-2 (g - s)."""


def pairs_of(
    problem: ScaledTimeProblem, slack: Values, multipliers: Values, model: SecondOrderModel
) -> Pairs:
    """The pairs of slacks and multipliers at a point, eliminated from its model."""
    w = scalings(problem, slack, multipliers)
    gradients = tuple(cone.barrier_gradient(s) for cone, s in zip(cones(problem), slack, strict=True))
    residuals = tuple(
        scaling.inverse_square(g - s) for scaling, s, g in zip(w, slack, model.values, strict=True)
    )
    eliminated = eliminate_inequalities(problem, model.jacobians, w, multipliers, gradients, residuals)
    return Pairs(slack, multipliers, w, gradients, eliminated)


class Step(eqx.Module):
    """A Newton direction."""

    z: Float[Array, "nodes variables"]
    y: Multipliers
    slack: Values


def newton_direction(
    problem: ScaledTimeProblem,
    model: SecondOrderModel,
    pairs: Pairs,
    mu: Scalar,
    factor: riccati.Factor,
    scale: Float[Array, "variables"],
) -> Step:
    """Newton direction towards the central path at mu.

    Args:
        problem: to solve.
        model: of the problem at the point.
        pairs: of the point.
        mu: barrier parameter of the target.
        factor: of the Newton matrix, in scaled variables.
        scale: typical sizes of the variables.
    """
    _, barrier, slack_residual = pairs.eliminated.products
    rhs = model.residual
    gradient = -mu * barrier - slack_residual - rhs.nodes
    right = riccati.KKTVector(gradient, -rhs.flow, -rhs.initial, -rhs.final)
    move = scaled(riccati.solve(factor, scaled(right, scale)), scale)
    derivatives = jacobian_product(problem, model.jacobians, move.nodes)
    slack = tuple(d + g - s for d, g, s in zip(derivatives, model.values, pairs.slack, strict=True))
    multipliers = tuple(
        -mu * gradient - y - w.inverse_square(ds)
        for w, gradient, y, ds in zip(
            pairs.scalings, pairs.barrier_gradients, pairs.multipliers, slack, strict=True
        )
    )
    return Step(move.nodes, Multipliers(move.flow, move.initial, move.final, multipliers), slack)


def factor_definite(matrix: riccati.LQProblem, last: Scalar) -> tuple[riccati.Factor, Scalar]:
    """Factor of the matrix, and the inertia correction used: the least of a rising sequence that makes it definite.

    The correction is zero where the second-order condition holds. Source: Waechter and Biegler (2006), algorithm IC.

    Args:
        matrix: of the Newton system.
        last: nonzero correction of an earlier iterate; zero if there was none.
    """

    least = jnp.where(last > 0, jnp.maximum(LEAST_CORRECTION, last / SHRINKAGE), FIRST_CORRECTION)
    return riccati.factor_shifted(matrix, least, riccati.Shifts(GROWTH, MOST_CORRECTION))
