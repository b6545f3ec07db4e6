"""The Newton system of the interior point, reduced to one block tridiagonal matrix.

The full system, over the variables x = (z, xi, zeta) and the multipliers y of all cones, is

    [ P   A'  ] [dx]   [rx]          xi_k   bounds the trust-region norm of node k,
    [ A  -W^2 ] [dy] = [ry]          zeta_l bounds the virtual control of link l.

Eliminated analytically, in this order: the half-spaces and cones of every node (they add G' W^-2 G to its
Hessian); xi, whose cone's lower-right block is a scaled identity plus rank one; zeta likewise, which leaves a
compliance C_l on the soft rows of each link; the nodes, by batched Cholesky of H_k. What remains is the Schur
complement in the link multipliers, S = M H^-1 M' + C: block tridiagonal, one block a link.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.product import ConeVector, Scaling
from jaxscp.cones.second_order import SecondOrderScaling
from jaxscp.conic.program import ConicMultipliers, StagedProgram
from jaxscp.core.trees import tree_axpy
from jaxscp.core.types import Count
from jaxscp.linalg import block_tridiagonal
from jaxscp.linalg.batched import gram, inverse_factor, times, times_transposed, transpose_times


class Primal(eqx.Module):
    """Variables of the conic form."""

    z: Float[Array, "nodes variables"]
    xi: Float[Array, "*nodes"]
    """Bounds of the trust-region norms, (nodes,); (0,) where the program has none."""
    zeta: Float[Array, "links"]
    """Bounds of the virtual controls."""


# --- the program in the form  min 1/2 x'Px + q'x,  A x + s = b,  s in K ---


def times_hessian(program: StagedProgram, x: Primal) -> Primal:
    """P x."""
    z = times(program.hessian, x.z)
    return Primal(z, jnp.zeros_like(x.xi), jnp.zeros_like(x.zeta))


def linear_cost(program: StagedProgram) -> Primal:
    """q."""
    xi = jnp.zeros((0,), program.gradient.dtype) if program.norm is None else program.norm.weight
    return Primal(program.gradient, xi, program.links.weight)


def times_constraints(program: StagedProgram, x: Primal) -> ConeVector:
    """A x."""
    link = program.links.apply(x.z)
    user = [times(cone.matrix, x.z) for cone in program.cones]
    trust = None if program.norm is None else -program.norm.scale * x.z
    second = pack(program, user, -x.xi, trust, -x.zeta, program.links.soft * link)
    rows = times(program.rows.matrix, x.z)
    return ConeVector((1.0 - program.links.soft) * link, rows, second)


def times_constraints_transpose(program: StagedProgram, y: ConeVector) -> Primal:
    """A' y."""
    user, trust, virtual = unpack(program, y.second)
    z = transpose(program, ConicMultipliers(link_multiplier(program, y), y.orthant, tuple(user)))
    if program.norm is not None:
        z -= program.norm.scale * trust[:, 1:]
    return Primal(z, -trust[:, 0], -virtual[:, 0])


def transpose(program: StagedProgram, y: ConicMultipliers) -> Float[Array, "nodes variables"]:
    """What multipliers of links, half-spaces and cones add to the gradient of the Lagrangian."""
    z = program.links.transpose_apply(y.links)
    z += transpose_times(program.rows.matrix, y.rows)
    for cone, multiplier in zip(program.cones, y.cones, strict=True):
        z += transpose_times(cone.matrix, multiplier)
    return z


def right_side(program: StagedProgram) -> ConeVector:
    """b."""
    norm, links = program.norm, program.links
    xi = jnp.zeros((0,) if norm is None else norm.weight.shape, program.gradient.dtype)
    trust = None if norm is None else -norm.scale * norm.centre
    user = [cone.offset for cone in program.cones]
    second = pack(program, user, xi, trust, jnp.zeros_like(links.weight), links.soft * links.offset)
    return ConeVector((1.0 - links.soft) * links.offset, program.rows.offset, second)


def link_multiplier(program: StagedProgram, y: ConeVector) -> Float[Array, "links rows"]:
    """Multipliers of the links: those of hard rows, and the tails of the virtual controls' cones."""
    soft = program.links.soft
    return (1.0 - soft) * y.zero + soft * unpack(program, y.second)[2][:, 1:]


def _cone_dimension(program: StagedProgram) -> int:
    dimensions = [cone.offset.shape[2] for cone in program.cones] + [1 + program.links.soft.shape[1]]
    return max(dimensions + ([] if program.norm is None else [1 + program.variables]))


def pack(program: StagedProgram, user, xi, trust, zeta, virtual) -> Float[Array, "cones dimension"]:
    """All second-order cones in one array, padded with zeros: the user's, trust region, virtual control."""
    groups = [v.reshape(-1, v.shape[-1]) for v in user]
    groups += [] if trust is None else [_stack(xi, trust)]
    groups.append(_stack(zeta, virtual))
    dimension = _cone_dimension(program)
    return jnp.concatenate([jnp.pad(v, ((0, 0), (0, dimension - v.shape[1]))) for v in groups])


def places(program: StagedProgram) -> tuple[slice, slice]:
    """Where the cones of the trust region and those of virtual control are among all: the user's come first."""
    user = sum(nodes * count for nodes, count, _ in (cone.offset.shape for cone in program.cones))
    end = user + (0 if program.norm is None else program.nodes)
    return slice(user, end), slice(end, None)


def unpack(program: StagedProgram, second: Float[Array, "cones dimension"]):
    """Groups of second-order cones: (the user's, trust region, virtual control)."""
    user, at = [], 0
    for cone in program.cones:
        nodes, count, dimension = cone.offset.shape
        user.append(second[at : at + nodes * count, :dimension].reshape(nodes, count, dimension))
        at += nodes * count
    trust, virtual = places(program)
    return user, second[trust, : 1 + program.variables], second[virtual, : 1 + program.links.soft.shape[1]]


def _unpack_scaling(program: StagedProgram, scaling: SecondOrderScaling):
    user, trust, virtual = unpack(program, scaling.w)
    eta, at, user_scalings = scaling.eta, 0, []
    for w in user:
        size = w.shape[0] * w.shape[1]
        user_scalings.append(SecondOrderScaling(eta[at : at + size].reshape(w.shape[:2]), w))
        at += size
    of_trust, of_virtual = (eta[place] for place in places(program))
    return user_scalings, SecondOrderScaling(of_trust, trust), SecondOrderScaling(of_virtual, virtual)


def _stack(head: Float[Array, "chain"], tail: Float[Array, "chain n"]) -> Float[Array, "chain n+1"]:
    return jnp.concatenate([head[:, None], tail], axis=1)


# --- its factorisation ---


class Factor(eqx.Module):
    """Everything that depends on the scaling alone and serves several right-hand sides."""

    nodes: Float[Array, "nodes variables variables"]
    """L_k^-1, where L_k L_k' is the Hessian of a node."""
    schur: block_tridiagonal.BlockCholesky


def factorise(program: StagedProgram, scaling: Scaling, regularisation: float) -> Factor:
    """Eliminate cones and nodes and factor the Schur complement; the regularisation makes both definite."""
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
    soft = _diagonal(program.links.soft)
    block = jax.vmap(_tail, in_axes=(None, 2), out_axes=2)(w, soft)
    return program.links.soft[:, :, None] * block


def _diagonal(v: Float[Array, "chain n"]) -> Float[Array, "chain n n"]:
    return v[:, :, None] * jnp.eye(v.shape[1], dtype=v.dtype)


def _tail(w: SecondOrderScaling, v: Float[Array, "chain n"]) -> Float[Array, "chain n"]:
    """(W^2)_{11} v = eta^2 (v + 2 w1 w1'v)."""
    w1 = w.w[:, 1:]
    return w.eta[:, None] ** 2 * (v + 2.0 * w1 * jnp.sum(w1 * v, axis=1, keepdims=True))


def _tail_inverse(w: SecondOrderScaling, v: Float[Array, "chain n"]) -> Float[Array, "chain n"]:
    """(W^2)_{11}^-1 v, split along and across w1 because the two parts differ by the square of |w1|."""
    w1 = w.w[:, 1:]
    size = jnp.sum(w1 * w1, axis=1, keepdims=True)
    unit = w1 / jnp.sqrt(jnp.maximum(size, 1e-300))
    part = jnp.sum(unit * v, axis=1, keepdims=True)
    across = v - unit * part
    across = across - unit * jnp.sum(unit * across, axis=1, keepdims=True)  # twice is enough
    return (across + unit * part / (1.0 + 2.0 * size)) / w.eta[:, None] ** 2


def _tail_head(w: SecondOrderScaling) -> Float[Array, "chain n"]:
    """(W^2)_{10} = 2 eta^2 w0 w1."""
    return 2.0 * (w.eta**2 * w.w[:, 0])[:, None] * w.w[:, 1:]


# --- its solution ---


def solve(
    program: StagedProgram,
    scaling: Scaling,
    factor: Factor,
    rx: Primal,
    ry: ConeVector,
    refinements: Count | int,
) -> tuple[Primal, ConeVector]:
    """Solve the full system for one right-hand side.

    Refinement is against the full system, not the reduced one: eliminating a cone whose point is near its
    boundary loses as many digits as its scaling has spread, and this is where they come back.
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
    zero = jax.tree.map(jnp.zeros_like, (rx, ry))  # from here the first round solves, the others refine
    return jax.lax.fori_loop(0, 1 + refinements, refine, zero)


def _solve_once(program: StagedProgram, scaling: Scaling, factor: Factor, rx: Primal, ry: ConeVector):
    soft = program.links.soft
    user, trust, virtual = _unpack_scaling(program, scaling.second)
    user_right, trust_right, virtual_right = unpack(program, ry.second)

    z_right = rx.z + transpose_times(program.rows.matrix, ry.orthant / scaling.orthant**2)
    for cone, w, r in zip(program.cones, user, user_right, strict=True):
        z_right += transpose_times(cone.matrix, w.inverse_square(r))
    if program.norm is not None:
        trust_shift = trust_right[:, 1:] - _tail_head(trust) * rx.xi[:, None]
        z_right -= program.norm.scale * _tail_inverse(trust, trust_shift)
    link_right = (1.0 - soft) * ry.zero
    link_right += soft * (virtual_right[:, 1:] - _tail_head(virtual) * rx.zeta[:, None])

    z = _node_solve(factor, z_right)
    link = block_tridiagonal.solve(factor.schur, program.links.apply(z) - link_right)
    z = z - _node_solve(factor, program.links.transpose_apply(link))

    rows = (times(program.rows.matrix, z) - ry.orthant) / scaling.orthant**2
    user_y = [
        w.inverse_square(times(cone.matrix, z) - r)
        for cone, w, r in zip(program.cones, user, user_right, strict=True)
    ]
    trust_y = None
    if program.norm is not None:
        trust_y = -_tail_inverse(trust, program.norm.scale * z + trust_shift)
    second = pack(program, user_y, -rx.xi, trust_y, -rx.zeta, soft * link)
    # The bounds follow from the heads of their cones:  -xi - (W^2 y)_0 = ry_0.
    _, trust_head, virtual_head = unpack(program, -ry.second - scaling.second.square(second))
    return (
        Primal(z, trust_head[:, 0], virtual_head[:, 0]),
        ConeVector((1.0 - soft) * link, rows, second),
    )


def _node_solve(factor: Factor, right: Float[Array, "nodes variables"]) -> Float[Array, "nodes variables"]:
    return transpose_times(factor.nodes, times(factor.nodes, right))
