"""Conic form of a staged program:  min 1/2 x'Px + q'x  subject to  A x + s = b,  s in K.

Two kinds of variables bound the norms of the cost, so that the cost is quadratic:

    x = (z, xi, zeta),    |D_k (z_k - r_k)| <= xi_k  (trust region),    |V_l nu_l| <= zeta_l  (virtual control).

K is the product of the zero cone (hard rows of the links), the nonnegative orthant (half-spaces) and second-order
cones in this order: the user's cones, the trust region's, virtual control's.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.product import ConeVector
from jaxscp.conic.program import ConicMultipliers, StagedProgram
from jaxscp.linalg.batched import times, transpose_times


class Primal(eqx.Module):
    """Variables x = (z, xi, zeta) of the conic form."""

    z: Float[Array, "nodes variables"]
    xi: Float[Array, "*nodes"]
    """Bounds of the trust-region norms, (nodes,); (0,) if the program has no trust region."""
    zeta: Float[Array, "links"]
    """Bounds of the norms of virtual control."""


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
    second = pack_cones(program, user, -x.xi, trust, -x.zeta, program.links.soft * link)
    rows = times(program.rows.matrix, x.z)
    return ConeVector((1.0 - program.links.soft) * link, rows, second)


def times_constraints_transpose(program: StagedProgram, y: ConeVector) -> Primal:
    """A' y."""
    user, trust, virtual = unpack_cones(program, y.second)
    z = transpose_product(program, ConicMultipliers(link_multipliers(program, y), y.orthant, tuple(user)))
    if program.norm is not None:
        z -= program.norm.scale * trust[:, 1:]
    return Primal(z, -trust[:, 0], -virtual[:, 0])


def transpose_product(program: StagedProgram, y: ConicMultipliers) -> Float[Array, "nodes variables"]:
    """Constraint matrix of links, half-spaces and user's cones, transposed, times their multipliers."""
    z = program.links.transpose_apply(y.links)
    z += transpose_times(program.rows.matrix, y.rows)
    for cone, multiplier in zip(program.cones, y.cones, strict=True):
        z += transpose_times(cone.matrix, multiplier)
    return z


def constraint_offset(program: StagedProgram) -> ConeVector:
    """b."""
    norm, links = program.norm, program.links
    xi = jnp.zeros((0,) if norm is None else norm.weight.shape, program.gradient.dtype)
    trust = None if norm is None else -norm.scale * norm.centre
    user = [cone.offset for cone in program.cones]
    second = pack_cones(program, user, xi, trust, jnp.zeros_like(links.weight), links.soft * links.offset)
    return ConeVector((1.0 - links.soft) * links.offset, program.rows.offset, second)


def link_multipliers(program: StagedProgram, y: ConeVector) -> Float[Array, "links rows"]:
    """Multipliers of the links: zero cone for hard rows, tails of virtual control's cones for soft rows."""
    soft = program.links.soft
    return (1.0 - soft) * y.zero + soft * unpack_cones(program, y.second)[2][:, 1:]


# --- second-order cones: one array for all groups ---


def pack_cones(program: StagedProgram, user, xi, trust, zeta, virtual) -> Float[Array, "cones dimension"]:
    """All second-order cones in one array, padded with zeros: user's, trust region, virtual control."""
    groups = [v.reshape(-1, v.shape[-1]) for v in user]
    groups += [] if trust is None else [_prepend(xi, trust)]
    groups.append(_prepend(zeta, virtual))
    dimension = _largest_dimension(program)
    return jnp.concatenate([jnp.pad(v, ((0, 0), (0, dimension - v.shape[1]))) for v in groups])


def norm_slices(program: StagedProgram) -> tuple[slice, slice]:
    """Slices of the trust region's and of virtual control's cones among all second-order cones."""
    user = sum(nodes * count for nodes, count, _ in (cone.offset.shape for cone in program.cones))
    end = user + (0 if program.norm is None else program.nodes)
    return slice(user, end), slice(end, None)


def unpack_cones(program: StagedProgram, second: Float[Array, "cones dimension"]):
    """Groups of second-order cones: (user's, trust region, virtual control)."""
    user, start = [], 0
    for cone in program.cones:
        nodes, count, dimension = cone.offset.shape
        user.append(second[start : start + nodes * count, :dimension].reshape(nodes, count, dimension))
        start += nodes * count
    trust, virtual = norm_slices(program)
    return user, second[trust, : 1 + program.variables], second[virtual, : 1 + program.links.soft.shape[1]]


def _largest_dimension(program: StagedProgram) -> int:
    dimensions = [cone.offset.shape[2] for cone in program.cones] + [1 + program.links.soft.shape[1]]
    return max(dimensions + ([] if program.norm is None else [1 + program.variables]))


def _prepend(head: Float[Array, "chain"], tail: Float[Array, "chain n"]) -> Float[Array, "chain n+1"]:
    return jnp.concatenate([head[:, None], tail], axis=1)
