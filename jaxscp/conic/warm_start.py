"""Where the interior point starts near a point that is thought to be not far from the solution: on the central path.

Of the point z and its multipliers y, slacks follow from the program. Pushed inside the cones as they are, s and y would
be far from centred; the pair with s o y = mu e that keeps their difference s - y is centred, and what it changes is of
the size of sqrt(mu) at most (``smoothing``). The farther the pair is from complementary, the larger is mu.

Where the soft links do not hold at z, virtual control would make up for it, and the steps would have its price to take
away again. It is kept where its multiplier is at its bound, as it is at a solution with virtual control. Elsewhere it
starts at zero: what the links lack is a residual, which a whole step takes away.

The trust region's bounds get more room than the central path gives them at a point that has not moved yet, or they
alone would hold the first steps.
"""

import jax
import jax.numpy as jnp

from jaxscp.cones.product import ConeVector, degree
from jaxscp.conic import kkt
from jaxscp.conic.kkt import Primal
from jaxscp.conic.program import StagedProgram, WarmStart
from jaxscp.conic.smoothing import central_pair
from jaxscp.core.trees import tree_axpy
from jaxscp.core.types import Scalar

# mu, in equilibrated units, is this times that power of the mean product of slacks and multipliers as they are, within
# limits: found by trial on subproblems of random flights in the paper's mode
MU, POWER, LEAST, MOST = 0.3, 0.2, 1e-3, 3.0

ROOM = 2.0  # for moves: times their price, of mu; by trial too
AT_BOUND = 0.99  # of its price, from which on a multiplier speaks for virtual control


def central_start(program: StagedProgram, near: WarmStart) -> tuple[Primal, ConeVector, ConeVector]:
    """Variables, multipliers and slacks of the start, for an equilibrated program."""
    norm, soft, links = program.norm, program.links.soft, near.multipliers.links
    virtual = jnp.linalg.norm(program.virtual_control(near.z), axis=1)
    moved = None if norm is None else norm.scale * (near.z - norm.centre)
    xi = jnp.zeros((0,), virtual.dtype) if moved is None else jnp.linalg.norm(moved, axis=1)
    x = Primal(near.z, xi, virtual)

    # Heads are what the prices of the bounds ask for; the trust region's tail is not known, and taken for zero.
    head, tail = (None, None) if norm is None else (norm.weight, jnp.zeros_like(near.z))
    second = kkt.pack(program, near.multipliers.cones, head, tail, program.links.weight, soft * links)
    y = ConeVector((1.0 - soft) * links, near.multipliers.rows, second)
    s = tree_axpy(-1.0, kkt.times_constraints(program, x), kkt.right_side(program))
    s = ConeVector(jnp.zeros_like(s.zero), s.orthant, s.second)
    mu = jnp.clip(MU * _apart(s, y) ** POWER, LEAST, MOST)

    trust, of_virtual = kkt.places(program)
    kept = (jnp.linalg.norm(soft * links, axis=1) > AT_BOUND * program.links.weight).astype(virtual.dtype)
    x = Primal(near.z, xi, kept * virtual)
    s = ConeVector(s.zero, s.orthant, s.second.at[of_virtual].multiply(kept[:, None]))
    pair = central_pair(jax.tree.map(jnp.subtract, s, y), mu)
    second = pair.s.second.at[trust, 0].add(ROOM * mu / pair.y.second[trust, 0])
    return x, pair.y, ConeVector(pair.s.zero, pair.s.orthant, second)


def _apart(s: ConeVector, y: ConeVector) -> Scalar:
    """Mean product of slack and multiplier, without its sign, of a half-space or cone."""
    rows, cones = jnp.abs(s.orthant * y.orthant), jnp.abs(jnp.sum(s.second * y.second, axis=1))
    return (jnp.sum(rows) + jnp.sum(cones)) / degree(s)
