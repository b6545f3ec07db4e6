"""The convex subproblem as data: a chain of nodes joined by links (equation 19).

    minimise    sum_k  1/2 z_k' P_k z_k + q_k' z_k + w_k |D_k (z_k - r_k)|      (the last term: trust region)
                       + sum_l  W_l |V_l nu_l|                                 (virtual control)
    subject to  E_l z_{l-1} + F_l z_l + V_l nu_l = d_l                         l = 0 .. N   (links)
                g_k - G_k z_k >= 0                                             k = 0 .. N-1 (half-spaces)
                c_k - C_k z_k in second-order cone                             (cones)

Link 0 touches node 0 only and holds the initial boundary, link N node N - 1 only and holds the final one;
the links between hold the dynamics. V_l is a 0/1 diagonal: a soft row has virtual control, a hard row none.
Every array has the chain as its leading axis, so all stage work is batched over it.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.status import StatusCode
from jaxscp.core.types import Flag, Scalar
from jaxscp.linalg.batched import times, transpose_times


class CouplingRows(eqx.Module):
    """Equality rows E z_{l-1} + F z_l + V nu = d that join neighbouring nodes."""

    before: Float[Array, "links rows variables"]
    """E: columns of the node before the link; zero for link 0."""
    after: Float[Array, "links rows variables"]
    """F: columns of the node after the link; zero for link N."""
    offset: Float[Array, "links rows"]
    """d: right-hand side."""
    soft: Float[Array, "links rows"]
    """V: one where a row has virtual control, zero where it is hard."""
    weight: Float[Array, "links"]
    """W: price of the Euclidean norm of a link's virtual control."""

    def apply(self, z: Float[Array, "nodes variables"]) -> Float[Array, "links rows"]:
        """E z_{l-1} + F z_l for every link."""
        z_before = jnp.concatenate([jnp.zeros_like(z[:1]), z])
        z_after = jnp.concatenate([z, jnp.zeros_like(z[:1])])
        return times(self.before, z_before) + times(self.after, z_after)

    def transpose_apply(self, y: Float[Array, "links rows"]) -> Float[Array, "nodes variables"]:
        """The adjoint of ``apply``."""
        return transpose_times(self.before[1:], y[1:]) + transpose_times(self.after[:-1], y[:-1])


class HalfSpaceRows(eqx.Module):
    """Half-spaces ``matrix z <= offset`` at every node. A row of zeros with offset one is inactive."""

    matrix: Float[Array, "nodes rows variables"]
    offset: Float[Array, "nodes rows"]


class Cones(eqx.Module):
    """Second-order cones ``offset - matrix z in {(t, v): |v| <= t}`` at every node, all of one dimension."""

    matrix: Float[Array, "nodes cones dimension variables"]
    offset: Float[Array, "nodes cones dimension"]


class NormCost(eqx.Module):
    """Cost ``weight |scale * (z - centre)|`` at every node: the paper's unsquared trust region (19f)."""

    weight: Float[Array, "nodes"]
    scale: Float[Array, "nodes variables"]
    centre: Float[Array, "nodes variables"]


class StagedProgram(eqx.Module):
    """A convex conic program on a chain of N nodes; see the module's head for the mathematics."""

    hessian: Float[Array, "nodes variables variables"]
    gradient: Float[Array, "nodes variables"]
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
        """Cost of a point, with virtual control the least that closes the soft links."""
        cost = 0.5 * jnp.vdot(z, times(self.hessian, z)) + jnp.vdot(self.gradient, z)
        cost += jnp.vdot(self.links.weight, jnp.linalg.norm(self.virtual_control(z), axis=-1))
        if self.norm is not None:
            cost += jnp.vdot(
                self.norm.weight, jnp.linalg.norm(self.norm.scale * (z - self.norm.centre), axis=-1)
            )
        return cost

    def virtual_control(self, z: Float[Array, "nodes variables"]) -> Float[Array, "links rows"]:
        """nu: what the soft rows of the links lack at a point."""
        return self.links.soft * (self.links.offset - self.links.apply(z))

    def violation(self, z: Float[Array, "nodes variables"]) -> Scalar:
        """Largest violation of hard links, half-spaces and cones, in each row's own unit."""
        hard = (1.0 - self.links.soft) * (self.links.offset - self.links.apply(z))
        worst = jnp.maximum(jnp.max(jnp.abs(hard)), jnp.max(times(self.rows.matrix, z) - self.rows.offset))
        for cone in self.cones:
            slack = cone.offset - times(cone.matrix, z)
            worst = jnp.maximum(worst, jnp.max(jnp.linalg.norm(slack[..., 1:], axis=-1) - slack[..., 0]))
        return jnp.maximum(worst, 0.0)


class ConicMultipliers(eqx.Module):
    """Lagrange multipliers of a program, one for every constraint row, signed as in CLARABEL's convention."""

    links: Float[Array, "links link_rows"]
    rows: Float[Array, "nodes rows"]
    cones: tuple[Float[Array, "nodes _ _"], ...]

    @classmethod
    def zeros(cls, program: StagedProgram) -> "ConicMultipliers":
        """None of them active."""
        cones = tuple(jnp.zeros_like(cone.offset) for cone in program.cones)
        return cls(jnp.zeros_like(program.links.offset), jnp.zeros_like(program.rows.offset), cones)


class WarmStart(eqx.Module):
    """Where the solution of a program is thought to be: at that of another program that is like it, say.

    Example:
        >>> from jaxscp.conic import WarmStart
        >>> from jaxscp.conic.random_programs import random_program
        >>> from jaxscp.conic.interior_point import InteriorPoint
        >>> program = random_program(0, norm=False)
        >>> solver = InteriorPoint(tolerance=1e-4)
        >>> before = solver(program)
        >>> again = solver(program, near=WarmStart(before.z, before.multipliers))
        >>> int(again.iterations) < int(before.iterations)
        True
    """

    z: Float[Array, "nodes variables"]
    multipliers: ConicMultipliers
    known: Flag | bool = True
    """Whether anything is thought of it at all."""


class ConicSolution(eqx.Module):
    """What every conic solver returns.

    ``status`` is ``converged`` only where the gap and both residuals met the tolerance.
    """

    z: Float[Array, "nodes variables"]
    multipliers: ConicMultipliers
    objective: Scalar
    status: StatusCode
    iterations: jax.Array


ConicSolver = Callable[[StagedProgram, Scalar | float, WarmStart], ConicSolution]
"""Solves a program to some accuracy, of which its own tolerance is enough, maybe from a point near the solution."""
