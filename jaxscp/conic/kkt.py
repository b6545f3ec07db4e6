"""Newton system of the interior point (KKT system), reduced to one block tridiagonal matrix.

The unknowns are the variables x = (z, xi, zeta) of the conic form and the multipliers y of all cones:

    [ P   A'  ] [dx]   [rx]
    [ A  -W^2 ] [dy] = [ry],        W: Nesterov-Todd scaling.

Eliminated analytically, in this order:

1. half-spaces and cones of every node: they add G' W^-2 G to the node's Hessian;
2. xi, whose cone's lower-right block is a scaled identity plus a rank-one matrix;
3. zeta likewise, which leaves a compliance C_l on the soft rows of each link;
4. the nodes, by a batched Cholesky factorisation of their Hessians H_k.

The Schur complement in the link multipliers remains, S = M H^-1 M' + C: block tridiagonal, one block per link.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.product import ConeVector, Scaling
from jaxscp.cones.second_order import SecondOrderScaling
from jaxscp.conic.conic_form import (
    Primal,
    norm_slices,
    pack_cones,
    times_constraints,
    times_constraints_transpose,
    times_hessian,
    unpack_cones,
)
from jaxscp.conic.program import StagedProgram
from jaxscp.core.trees import tree_axpy
from jaxscp.core.types import Count
from jaxscp.linalg import block_tridiagonal
from jaxscp.linalg.batched import gram, inverse_factor, times, times_transposed, transpose_times

# --- factorisation ---


class Factor(eqx.Module):
    """Factorisation of the KKT matrix for one scaling; it serves several right-hand sides."""

    nodes: Float[Array, "nodes variables variables"]
    """L_k^-1, where L_k L_k' is the Hessian H_k of a node."""
    schur: block_tridiagonal.BlockCholesky
    """Cholesky factor of S."""


def factorise(program: StagedProgram, scaling: Scaling, regularisation: float) -> Factor:
    """Factor of the KKT matrix; the regularisation makes H_k and S positive definite."""
    hessian = _node_hessian(program, scaling)
    n, m = program.variables, program.links.soft.shape[1]
    inverse = inverse_factor(hessian + regularisation * jnp.eye(n, dtype=hessian.dtype))
    after = times_transposed(inverse, program.links.after[:-1])  # L_k^-1 F_k', node k in link k
    before = times_transposed(inverse, program.links.before[1:])  # L_k^-1 E_{k+1}', node k in link k + 1
    compliance = _compliance(program, _unpack_scaling(program, scaling.second)[2])
    diagonal = compliance + regularisation * jnp.eye(m, dtype=hessian.dtype)
    diagonal = diagonal.at[:-1].add(gram(after, after))
    diagonal = diagonal.at[1:].add(gram(before, before))
    above = gram(after, before)
    above = jnp.concatenate([above, jnp.zeros_like(above[:1])])
    return Factor(inverse, block_tridiagonal.factor(diagonal, above))


def _node_hessian(program: StagedProgram, scaling: Scaling) -> Float[Array, "nodes variables variables"]:
    """H_k without regularisation: P_k and the eliminated half-spaces, cones and trust region."""
    weight = scaling.orthant**-2
    hessian = program.hessian + jnp.einsum(
        "kln,kl,klm->knm", program.rows.matrix, weight, program.rows.matrix
    )
    user, trust, _ = _unpack_scaling(program, scaling.second)
    for cone, w in zip(program.cones, user, strict=True):
        inverse = jax.vmap(w.inverse_square, in_axes=-1, out_axes=-1)(cone.matrix)
        hessian += jnp.einsum("kcdn,kcdm->knm", cone.matrix, inverse)
    if program.norm is not None:
        scale = program.norm.scale
        block = jax.vmap(_tail_inverse, in_axes=(None, 2), out_axes=2)(trust, _diagonal(scale))
        hessian += scale[:, :, None] * block
    return hessian


def _compliance(program: StagedProgram, w: SecondOrderScaling) -> Float[Array, "links rows rows"]:
    """C_l = V (W^2)_{11} V, where W scales the cones of virtual control."""
    soft = _diagonal(program.links.soft)
    block = jax.vmap(_tail_block, in_axes=(None, 2), out_axes=2)(w, soft)
    return program.links.soft[:, :, None] * block


# --- solution ---


def solve(
    program: StagedProgram,
    scaling: Scaling,
    factor: Factor,
    rx: Primal,
    ry: ConeVector,
    refinements: Count | int,
) -> tuple[Primal, ConeVector]:
    """Solution (dx, dy) of the KKT system for one right-hand side (rx, ry).

    Refinement uses residuals of the full system, not of the reduced one. The elimination of a cone whose point is
    near the boundary loses digits, as many as its scaling spans; refinement restores them.
    """

    def refine(_, solution):
        x, y = solution
        gradient = tree_axpy(1.0, times_constraints_transpose(program, y), times_hessian(program, x))
        slack = tree_axpy(-1.0, scaling.square(y), times_constraints(program, x))
        dx, dy = _solve_once(
            program, scaling, factor, tree_axpy(-1.0, gradient, rx), tree_axpy(-1.0, slack, ry)
        )
        return tree_axpy(1.0, dx, x), tree_axpy(1.0, dy, y)

    if isinstance(refinements, int) and refinements == 0:
        return _solve_once(program, scaling, factor, rx, ry)
    zero = jax.tree.map(jnp.zeros_like, (rx, ry))  # the first round solves, the others refine
    return jax.lax.fori_loop(0, 1 + refinements, refine, zero)


def _solve_once(program: StagedProgram, scaling: Scaling, factor: Factor, rx: Primal, ry: ConeVector):
    soft = program.links.soft
    user, trust, virtual = _unpack_scaling(program, scaling.second)
    user_rhs, trust_rhs, virtual_rhs = unpack_cones(program, ry.second)

    z_rhs = rx.z + transpose_times(program.rows.matrix, ry.orthant / scaling.orthant**2)
    for cone, w, r in zip(program.cones, user, user_rhs, strict=True):
        z_rhs += transpose_times(cone.matrix, w.inverse_square(r))
    if program.norm is not None:
        trust_tail = trust_rhs[:, 1:] - _tail_head(trust) * rx.xi[:, None]
        z_rhs -= program.norm.scale * _tail_inverse(trust, trust_tail)
    link_rhs = (1.0 - soft) * ry.zero
    link_rhs += soft * (virtual_rhs[:, 1:] - _tail_head(virtual) * rx.zeta[:, None])

    z = _node_solve(factor, z_rhs)
    link = block_tridiagonal.solve(factor.schur, program.links.apply(z) - link_rhs)
    z = z - _node_solve(factor, program.links.transpose_apply(link))

    rows = (times(program.rows.matrix, z) - ry.orthant) / scaling.orthant**2
    user_y = [
        w.inverse_square(times(cone.matrix, z) - r)
        for cone, w, r in zip(program.cones, user, user_rhs, strict=True)
    ]
    trust_y = None
    if program.norm is not None:
        trust_y = -_tail_inverse(trust, program.norm.scale * z + trust_tail)
    second = pack_cones(program, user_y, -rx.xi, trust_y, -rx.zeta, soft * link)
    # The bounds follow from the heads of their cones:  -xi - (W^2 y)_0 = ry_0.
    _, trust_head, virtual_head = unpack_cones(program, -ry.second - scaling.second.square(second))
    return (
        Primal(z, trust_head[:, 0], virtual_head[:, 0]),
        ConeVector((1.0 - soft) * link, rows, second),
    )


def _node_solve(factor: Factor, rhs: Float[Array, "nodes variables"]) -> Float[Array, "nodes variables"]:
    """H^-1 rhs."""
    return transpose_times(factor.nodes, times(factor.nodes, rhs))


# --- blocks of W^2 of a second-order cone: eta^2 (2 w w' - J), w = (w0, w1) ---


def _unpack_scaling(program: StagedProgram, scaling: SecondOrderScaling):
    """Scalings of the groups of cones: (user's, trust region, virtual control)."""
    user, trust, virtual = unpack_cones(program, scaling.w)
    eta, start, user_scalings = scaling.eta, 0, []
    for w in user:
        size = w.shape[0] * w.shape[1]
        user_scalings.append(SecondOrderScaling(eta[start : start + size].reshape(w.shape[:2]), w))
        start += size
    trust_eta, virtual_eta = (eta[group] for group in norm_slices(program))
    return user_scalings, SecondOrderScaling(trust_eta, trust), SecondOrderScaling(virtual_eta, virtual)


def _diagonal(v: Float[Array, "chain n"]) -> Float[Array, "chain n n"]:
    return v[:, :, None] * jnp.eye(v.shape[1], dtype=v.dtype)


def _tail_block(w: SecondOrderScaling, v: Float[Array, "chain n"]) -> Float[Array, "chain n"]:
    """(W^2)_{11} v = eta^2 (v + 2 w1 w1'v)."""
    w1 = w.w[:, 1:]
    return w.eta[:, None] ** 2 * (v + 2.0 * w1 * jnp.sum(w1 * v, axis=1, keepdims=True))


def _tail_inverse(w: SecondOrderScaling, v: Float[Array, "chain n"]) -> Float[Array, "chain n"]:
    """(W^2)_{11}^-1 v, split along and across w1 because the eigenvalues differ by 1 + 2 |w1|^2."""
    w1 = w.w[:, 1:]
    size = jnp.sum(w1 * w1, axis=1, keepdims=True)
    unit = w1 / jnp.sqrt(jnp.maximum(size, 1e-300))
    part = jnp.sum(unit * v, axis=1, keepdims=True)
    across = v - unit * part
    across = across - unit * jnp.sum(
        unit * across, axis=1, keepdims=True
    )  # removes the rounding of the first
    return (across + unit * part / (1.0 + 2.0 * size)) / w.eta[:, None] ** 2


def _tail_head(w: SecondOrderScaling) -> Float[Array, "chain n"]:
    """(W^2)_{10} = 2 eta^2 w0 w1."""
    return 2.0 * (w.eta**2 * w.w[:, 0])[:, None] * w.w[:, 1:]
