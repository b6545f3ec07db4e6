"""Where the interior point starts near a point that is thought to be not far from the solution: on the central path.

Of the point z and its multipliers y, slacks follow from the program. Pushed inside the cones as they are, s and y would
be far from centred; the pair with s o y = mu e that keeps their difference s - y is centred, and what it changes is of
the size of sqrt(mu) at most (``smoothing``). The farther z and y are from optimal, the larger is mu.
"""

import jax
import jax.numpy as jnp

from jaxscp.conic import kkt
from jaxscp.conic.cones import ConeVector, tree_axpy
from jaxscp.conic.kkt import Primal
from jaxscp.conic.program import Near, StagedProgram
from jaxscp.conic.smoothing import central_pair

# mu, in equilibrated units, is this share of the largest residual of stationarity, within limits: found by trial on
# subproblems of both missions in both modes
SHARE, LEAST, MOST = 0.2, 0.02, 3.0


def central_start(program: StagedProgram, near: Near) -> tuple[Primal, ConeVector, ConeVector]:
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
    stationarity = tree_axpy(1.0, kkt.times_hessian(program, x), kkt.times_constraints_transpose(program, y))
    lack = jnp.max(jnp.abs(stationarity.z + program.gradient))
    mu = jnp.clip(SHARE * lack, LEAST, MOST)

    s = tree_axpy(-1.0, kkt.times_constraints(program, x), kkt.right_side(program))
    s = ConeVector(jnp.zeros_like(s.zero), s.orthant, s.second)
    pair = central_pair(jax.tree.map(jnp.subtract, s, y), mu)
    return x, pair.y, pair.s
