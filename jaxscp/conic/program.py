"""Staged conic program: a chain of N nodes whose neighbours are coupled by linear equations (equation 19).

    minimise    sum_k  1/2 z_k' P_k z_k + q_k' z_k + w_k |D_k (z_k - r_k)|     trust region: the last term
                       + sum_l  W_l |V_l nu_l|                                 virtual control
    subject to  E_l z_{l-1} + F_l z_l + V_l nu_l = d_l       l = 0 .. N        links (coupling rows)
                g_k - G_k z_k >= 0                           k = 0 .. N - 1    half-spaces
                c_k - C_k z_k in a second-order cone         k = 0 .. N - 1    cones

Link l couples nodes l - 1 and l: the dynamics. Links 0 and N touch one node each: the initial and final conditions.
V_l is a diagonal of zeros and ones: a soft row has virtual control nu, a hard row has none.
The chain is the leading axis of every array, so all work on a node is batched.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.backends.serving import index_of
from jaxscp.core.status import StatusCode
from jaxscp.core.types import Flag, Scalar
from jaxscp.linalg.batched import times, transpose_times


class CouplingRows(eqx.Module):
    """Equality rows E z_{l-1} + F z_l + V nu = d of all links."""

    before: Float[Array, "links rows variables"]
    """E: coefficients of node l - 1; zero for link 0."""
    after: Float[Array, "links rows variables"]
    """F: coefficients of node l; zero for link N."""
    offset: Float[Array, "links rows"]
    """d: right-hand side."""
    soft: Float[Array, "links rows"]
    """Diagonal of V: one for a row with virtual control, zero for a hard row."""
    weight: Float[Array, "links"]
    """W: penalty weight on the Euclidean norm of a link's virtual control."""

    def apply(self, z: Float[Array, "nodes variables"]) -> Float[Array, "links rows"]:
        """Left-hand sides E z_{l-1} + F z_l."""
        z_before = jnp.concatenate([jnp.zeros_like(z[:1]), z])
        z_after = jnp.concatenate([z, jnp.zeros_like(z[:1])])
        return times(self.before, z_before) + times(self.after, z_after)

    def transpose_apply(self, y: Float[Array, "links rows"]) -> Float[Array, "nodes variables"]:
        """Transpose of ``apply``: E_{k+1}' y_{k+1} + F_k' y_k for every node k."""
        return transpose_times(self.before[1:], y[1:]) + transpose_times(self.after[:-1], y[:-1])


class HalfSpaceRows(eqx.Module):
    """Half-spaces ``matrix z <= offset`` at every node. A row of zeros with offset one is inactive."""

    matrix: Float[Array, "nodes rows variables"]
    """G."""
    offset: Float[Array, "nodes rows"]
    """g."""


class Cones(eqx.Module):
    """Second-order cones ``offset - matrix z in {(t, v): |v| <= t}`` at every node, all of one dimension."""

    matrix: Float[Array, "nodes cones dimension variables"]
    """C."""
    offset: Float[Array, "nodes cones dimension"]
    """c."""


class NormCost(eqx.Module):
    """Cost ``weight |scale * (z - centre)|`` at every node: the paper's unsquared trust region (19f)."""

    weight: Float[Array, "nodes"]
    """w."""
    scale: Float[Array, "nodes variables"]
    """Diagonal of D."""
    centre: Float[Array, "nodes variables"]
    """r."""


class StagedProgram(eqx.Module):
    """Convex conic program on a chain of N nodes. The module's docstring states the mathematics."""

    hessian: Float[Array, "nodes variables variables"]
    """P."""
    gradient: Float[Array, "nodes variables"]
    """q."""
    links: CouplingRows
    rows: HalfSpaceRows
    cones: tuple[Cones, ...] = ()
    norm: NormCost | None = None

    @property
    def nodes(self) -> int:
        """Number of nodes N."""
        return self.gradient.shape[0]

    @property
    def variables(self) -> int:
        """Number of variables of one node."""
        return self.gradient.shape[1]

    def objective(self, z: Float[Array, "nodes variables"]) -> Scalar:
        """Cost of a point; virtual control is the smallest one that satisfies the soft rows."""
        cost = 0.5 * jnp.vdot(z, times(self.hessian, z)) + jnp.vdot(self.gradient, z)
        cost += jnp.vdot(self.links.weight, jnp.linalg.norm(self.virtual_control(z), axis=-1))
        if self.norm is not None:
            cost += jnp.vdot(
                self.norm.weight, jnp.linalg.norm(self.norm.scale * (z - self.norm.centre), axis=-1)
            )
        return cost

    def virtual_control(self, z: Float[Array, "nodes variables"]) -> Float[Array, "links rows"]:
        """Virtual control nu = V (d - E z_{l-1} - F z_l): residual of the soft rows."""
        return self.links.soft * (self.links.offset - self.links.apply(z))

    def violation(self, z: Float[Array, "nodes variables"]) -> Scalar:
        """Largest violation of hard rows, half-spaces and cones, in each row's own unit."""
        hard = (1.0 - self.links.soft) * (self.links.offset - self.links.apply(z))
        largest = jnp.maximum(jnp.max(jnp.abs(hard)), jnp.max(times(self.rows.matrix, z) - self.rows.offset))
        for cone in self.cones:
            slack = cone.offset - times(cone.matrix, z)
            largest = jnp.maximum(largest, jnp.max(jnp.linalg.norm(slack[..., 1:], axis=-1) - slack[..., 0]))
        return jnp.maximum(largest, 0.0)


class ConicMultipliers(eqx.Module):
    """Lagrange multipliers of a program, one for every constraint row, with CLARABEL's signs."""

    links: Float[Array, "links link_rows"]
    rows: Float[Array, "nodes rows"]
    cones: tuple[Float[Array, "nodes _ _"], ...]

    @classmethod
    def zeros(cls, program: StagedProgram) -> "ConicMultipliers":
        """Zero multipliers: no constraint is active."""
        cones = tuple(jnp.zeros_like(cone.offset) for cone in program.cones)
        return cls(jnp.zeros_like(program.links.offset), jnp.zeros_like(program.rows.offset), cones)


class WarmStart(eqx.Module):
    """Warm start: an estimate of the solution, often the solution of a similar program.

    Example:
        >>> from jaxscp.conic import WarmStart
        >>> from jaxscp.conic.random_programs import random_program
        >>> from jaxscp.conic.interior_point import InteriorPoint
        >>> program = random_program(0, norm=False)
        >>> solver = InteriorPoint(tolerance=1e-4)
        >>> cold = solver(program)
        >>> warm = solver(program, warm_start=WarmStart(cold.z, cold.multipliers))
        >>> int(warm.iterations) < int(cold.iterations)
        True
    """

    z: Float[Array, "nodes variables"]
    multipliers: ConicMultipliers
    available: Flag | bool = True
    """Whether there is an estimate; without one the solver starts cold."""


class ConicSolution(eqx.Module):
    """Solution of a program, as every conic solver returns it.

    ``status`` is ``converged`` only if the gap and both residuals are below the tolerance.
    """

    z: Float[Array, "nodes variables"]
    multipliers: ConicMultipliers
    objective: Scalar
    status: StatusCode
    iterations: jax.Array


def served_by(solver: "ConicSolver", program: StagedProgram) -> Int[Array, ""]:
    """Index into ``BACKENDS`` of a solver's implementation for a program; "other" for one without ``served_by``."""
    says = getattr(solver, "served_by", None)
    return index_of("other") if says is None else says(program)


ConicSolver = Callable[[StagedProgram, Scalar | float, WarmStart], ConicSolution]
"""A solver: (program, sufficient accuracy, warm start) -> solution."""
