"""Convex curvature for the subproblem, from the Lagrangian's, which is not convex.

``projected`` clips each interval's own block: robust far from the optimum, but what it clips slows the end.

``condensed`` adds and subtracts along the chain terms that cancel wherever the dynamics hold, 1/2 x' P x at every
node, with P from a Riccati recursion: each block is then as convex as the problem itself is in the directions that
its dynamics leave free (Verschueren et al., "A sparsity preserving convexification procedure for indefinite
quadratic programs arising in direct optimal control", 2017). With a quadratic on the constraints that the last
subproblem found active, this is exact near a solution that is a strict minimum. A block that is still not convex
is clipped.

All in scaled units, in which a variable's typical size is one.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscp.core.types import Scalar
from jaxscp.linalg.eigen.dispatch import eigen, nearest

FLOORS = (
    1e-4,
    1e-2,
    1.0,
)  # curvature to which that of a control's direction is raised, the first that serves
DEEPEST_CURVATURE = 100.0  # negative curvature a node may pass on before its block is clipped


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


def condensed(
    hessian: Float[Array, "intervals inputs inputs"],
    chain: LinearDynamics,
    final: Float[Array, "stage stage"],
) -> Convex:
    """Move curvature from interval to interval, backwards, until each block is convex.

    Args:
        hessian: blocks of the Lagrangian, with quadratics on active constraints.
        chain: the linearised dynamics.
        final: curvature that the conditions at the last node stand for.
    """
    states = chain.defect.shape[1]
    stage = final.shape[0]
    controls = stage - states
    carry_controls = jnp.concatenate([jnp.zeros((controls, stage)), jnp.eye(controls)], axis=1)

    def backward(after, interval):
        block, jacobian, defect = interval
        step = jnp.concatenate([jacobian, carry_controls])  # (x, U)_{i+1} = step w_i + offset
        offset = jnp.concatenate([defect, jnp.zeros(controls)])
        whole = block + step.T @ after @ step
        least, tries = _schur_complements(whole, stage)
        _, lowest = nearest(jnp.stack([before for before, _ in tries]))
        fine = lowest > -DEEPEST_CURVATURE

        def clipped(whole):
            return _schur_complements(_clip(whole, FLOORS[0])[0], stage)[1][0]

        def first_that_serves(whole):
            found = tries[-1]
            for i in reversed(range(len(FLOORS) - 1)):
                found = jax.tree.map(lambda a, b, i=i: jnp.where(fine[i], a, b), tries[i], found)
            return found

        before, convex = jax.lax.cond(jnp.any(fine), first_that_serves, clipped, whole)
        return before, (convex, step.T @ (after @ offset), ~(fine[0] & (least >= FLOORS[0])))

    first, (convex, gradient, clipped) = jax.lax.scan(
        backward, final, (hessian, chain.jacobian, chain.defect), reverse=True
    )
    # The first state is fixed, its controls are free and keep what the recursion leaves to them.
    free, least = _clip(first[states:, states:], 0.0)
    convex = convex.at[0, states:stage, states:stage].add(free)
    return Convex(convex, gradient, clipped.at[0].set(clipped[0] | (least < 0.0)))


def _clip(h: Float[Array, "n n"], least: float) -> tuple[Float[Array, "n n"], Scalar]:
    """Symmetric matrix with eigenvalues raised to ``least``, and the lowest it had."""
    raised = least * jnp.eye(h.shape[0], dtype=h.dtype)
    (convex,), (lowest,) = nearest((h - raised)[None])
    return convex + raised, lowest + least


def _schur_complements(whole: Float[Array, "n n"], stage: int):
    """Minimise over the controls at the interval's end, their curvature raised to each of the floors: the least
    curvature that they have themselves; by floor, what is left and what was used."""
    own, cross = whole[stage:, stage:], whole[stage:, :stage]
    (values,), (vectors,) = eigen(own[None])
    turned = vectors.T @ cross

    def at(floor):
        raised = jnp.maximum(values, floor)
        saved = turned.T @ (turned / raised[:, None])
        before = whole[:stage, :stage] - saved
        convex = jnp.block([[saved, cross.T], [cross, (vectors * raised) @ vectors.T]])
        return 0.5 * (before + before.T), 0.5 * (convex + convex.T)

    return jnp.min(values), [at(floor) for floor in FLOORS]
