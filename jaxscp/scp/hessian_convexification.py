"""Convexification of the Lagrangian's Hessian, for the subproblem.

``projected`` clips each interval's own block: robust far from the optimum, but the clipped curvature slows convergence.

``convexified_along_horizon`` adds and subtracts 1/2 x' P x at every node, terms that cancel where the dynamics hold,
with P from a Riccati recursion. Each block is then as convex as the problem in the directions that its dynamics leave
free. Source: Verschueren et al., "A sparsity preserving convexification procedure for indefinite quadratic programs
arising in direct optimal control" (2017). With a quadratic penalty on the active constraints, this is exact near a
strict minimum. A block that is still not convex is clipped.

All in scaled units, in which a variable's typical size is one.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscp.core import batching
from jaxscp.core.trees import tree_where
from jaxscp.core.types import Flag, Scalar
from jaxscp.linalg.eigen.dispatch import eigen, nearest

FLOORS = (1e-4, 1e-2, 1.0)  # least curvature of a control's direction: the first floor that suffices is taken
FEW: batching.Chunks = (
    64,
)  # batch elements clipped at once on a GPU: few need it, and eigenvalues take long
DEEPEST_CURVATURE = 100.0  # negative curvature that a node may pass on before its block is clipped


class LinearDynamics(eqx.Module):
    """The linearised dynamics between the stages (x_i, U_i), in scaled units."""

    jacobian: Float[Array, "intervals states inputs"]
    defect: Float[Array, "intervals states"]


class Convex(eqx.Module):
    """A convex quadratic for every interval: 1/2 w' hessian w + gradient . w."""

    hessian: Float[Array, "intervals inputs inputs"]
    gradient: Float[Array, "intervals inputs"]
    clipped: Bool[Array, "intervals"]
    """Whether curvature had to be changed."""


def projected(hessian: Float[Array, "intervals inputs inputs"]) -> Convex:
    """The nearest convex blocks: negative eigenvalues become zero."""
    convex, least = nearest(hessian)
    return Convex(convex, jnp.zeros(hessian.shape[:2], hessian.dtype), least < 0.0)


def convexified_along_horizon(
    hessian: Float[Array, "intervals inputs inputs"],
    dynamics: LinearDynamics,
    final: Float[Array, "stage stage"],
    needed: Flag | bool = True,
) -> Convex:
    """Convex blocks: curvature moves backwards from interval to interval.

    Args:
        hessian: blocks of the Lagrangian, with penalties on active constraints.
        dynamics: linearised about the reference.
        final: curvature of the conditions at the last node.
        needed: false for an element of a batch whose result is dropped; its blocks are not clipped, which takes long.
    """
    states = dynamics.defect.shape[1]
    stage = final.shape[0]
    controls = stage - states
    control_columns = jnp.concatenate([jnp.zeros((controls, stage)), jnp.eye(controls)], axis=1)

    def backward(after, interval):
        block, jacobian, defect = interval
        step = jnp.concatenate([jacobian, control_columns])  # (x, U)_{i+1} = step w_i + offset
        offset = jnp.concatenate([defect, jnp.zeros(controls)])
        whole = block + step.T @ after @ step
        before, convex, clipped = _convex_block(whole, stage, needed)
        return before, (convex, step.T @ (after @ offset), clipped)

    first, (convex, gradient, clipped) = jax.lax.scan(
        backward, final, (hessian, dynamics.jacobian, dynamics.defect), reverse=True
    )
    # The first state is fixed; its controls are free, and get the curvature that the recursion leaves.
    free, least = _clip(first[states:, states:], 0.0)
    convex = convex.at[0, states:stage, states:stage].add(free)
    return Convex(convex, gradient, clipped.at[0].set(clipped[0] | (least < 0.0)))


def _convex_block(whole: Float[Array, "n n"], stage: int, needed: Flag | bool):
    """Curvature passed on to the node before, the convex block, and whether it was clipped."""
    least, tries = _schur_complements(whole, stage)
    fine = _definite(jnp.stack([before for before, _ in tries]) + DEEPEST_CURVATURE * jnp.eye(stage))
    found = tries[-1]
    for i in reversed(range(len(FLOORS) - 1)):
        found = tree_where(fine[i], tries[i], found)

    def clipped(whole, *_):
        return _schur_complements(_clip(whole, FLOORS[0])[0], stage)[1][0]

    before, convex = batching.where_needed(needed & ~jnp.any(fine), clipped, whole, found, FEW)
    return before, convex, ~(fine[0] & (least >= FLOORS[0]))


def _definite(matrices: Float[Array, "count n n"]) -> Bool[Array, "count"]:
    """Whether symmetric matrices are positive definite; false where a number is not finite."""
    factor = jnp.linalg.cholesky(matrices, symmetrize_input=False)
    return jnp.all(jnp.isfinite(jnp.diagonal(factor, axis1=1, axis2=2)), axis=1)


def _clip(h: Float[Array, "n n"], least: float) -> tuple[Float[Array, "n n"], Scalar]:
    """The symmetric matrix with eigenvalues raised to ``least``, and its lowest eigenvalue before."""
    raised = least * jnp.eye(h.shape[0], dtype=h.dtype)
    (convex,), (lowest,) = nearest((h - raised)[None])
    return convex + raised, lowest + least


def _schur_complements(whole: Float[Array, "n n"], stage: int):
    """Minimisation over the controls at the interval's end, with their curvature raised to each of the floors.

    Returns:
        The least curvature of these controls; for every floor, the Schur complement and the block that was used.
    """
    own, cross = whole[stage:, stage:], whole[stage:, :stage]
    (values,), (vectors,) = eigen(own[None])
    rotated = vectors.T @ cross

    def at(floor):
        raised = jnp.maximum(values, floor)
        saved = rotated.T @ (rotated / raised[:, None])
        before = whole[:stage, :stage] - saved
        convex = jnp.block([[saved, cross.T], [cross, (vectors * raised) @ vectors.T]])
        return 0.5 * (before + before.T), 0.5 * (convex + convex.T)

    return jnp.min(values), [at(floor) for floor in FLOORS]
