"""Ruiz equilibration that keeps the program's structure: columns, rows and cost near unit size.

A second-order cone admits one scale for all its rows, and so do the soft rows of a link, whose virtual
control is measured by one Euclidean norm. Hard rows and half-spaces are scaled one by one.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.conic.program import (
    Cones,
    ConicMultipliers,
    CouplingRows,
    HalfSpaceRows,
    NormCost,
    StagedProgram,
    WarmStart,
)
from jaxscp.core.types import Scalar

_LOWEST, _HIGHEST = 1e-4, 1e4  # limits on each scale, as in OSQP and Clarabel


class Scales(eqx.Module):
    """What a program was multiplied by, so that its answer can be taken back."""

    columns: Float[Array, "nodes variables"]
    links: Float[Array, "links link_rows"]
    rows: Float[Array, "nodes rows"]
    cones: tuple[Float[Array, "nodes _"], ...]
    cost: Scalar

    def restore(
        self, z: Float[Array, "nodes variables"], multipliers: ConicMultipliers
    ) -> tuple[Float[Array, "nodes variables"], ConicMultipliers]:
        """Take a solution of the scaled program back to the given one."""
        cones = tuple(
            y * r[..., None] / self.cost for y, r in zip(multipliers.cones, self.cones, strict=True)
        )
        return self.columns * z, ConicMultipliers(
            multipliers.links * self.links / self.cost, multipliers.rows * self.rows / self.cost, cones
        )

    def apply(self, near: WarmStart) -> WarmStart:
        """Take a point of the given program to the scaled one."""
        given = near.multipliers
        cones = tuple(y * self.cost / r[..., None] for y, r in zip(given.cones, self.cones, strict=True))
        multipliers = ConicMultipliers(
            given.links * self.cost / self.links, given.rows * self.cost / self.rows, cones
        )
        return WarmStart(near.z / self.columns, multipliers, near.known)


def equilibrate(program: StagedProgram, rounds: int = 3) -> tuple[StagedProgram, Scales]:
    """Scale a program; ``Scales.restore`` takes its solution back, which does not depend on the scales: they have no
    derivative."""
    scales = _scales(jax.lax.stop_gradient(program), rounds)
    return scaled_by(program, scales), scales


def _scales(program: StagedProgram, rounds: int) -> Scales:
    scales = Scales(
        jnp.ones_like(program.gradient),
        jnp.ones_like(program.links.offset),
        jnp.ones_like(program.rows.offset),
        tuple(jnp.ones_like(cone.offset[..., 0]) for cone in program.cones),
        jnp.ones((), program.gradient.dtype),
    )
    # a loop, since the compiler would do a round again wherever the next one reads of it
    return jax.lax.fori_loop(0, rounds, lambda _, s: _refine(scaled_by(program, s), s), scales)


def _refine(scaled: StagedProgram, scales: Scales) -> Scales:
    """One Ruiz round: divide every row and column by the square root of its largest entry."""
    links = scaled.links
    size = [
        jnp.max(jnp.abs(scaled.hessian), axis=1),
        jnp.max(jnp.abs(links.before[1:]), axis=1),
        jnp.max(jnp.abs(links.after[:-1]), axis=1),
        jnp.max(jnp.abs(scaled.rows.matrix), axis=1, initial=0.0),
    ]
    size += [jnp.max(jnp.abs(cone.matrix), axis=(1, 2), initial=0.0) for cone in scaled.cones]
    columns = _shrink(jnp.max(jnp.stack(size), axis=0))
    link_size = jnp.maximum(jnp.max(jnp.abs(links.before), axis=2), jnp.max(jnp.abs(links.after), axis=2))
    soft_size = jnp.max(links.soft * link_size, axis=1, keepdims=True)
    link = _shrink(jnp.where(links.soft > 0, soft_size, link_size))
    rows = _shrink(jnp.max(jnp.abs(scaled.rows.matrix), axis=2))
    cones = tuple(_shrink(jnp.max(jnp.abs(cone.matrix), axis=(2, 3))) for cone in scaled.cones)
    clip = lambda scale: jnp.clip(scale, _LOWEST, _HIGHEST)  # noqa: E731
    new = Scales(
        clip(scales.columns * columns),
        clip(scales.links * link),
        clip(scales.rows * rows),
        tuple(clip(a * b) for a, b in zip(scales.cones, cones, strict=True)),
        scales.cost,
    )
    return eqx.tree_at(lambda s: s.cost, new, _cost_scale(scaled, columns) * scales.cost)


def _cost_scale(scaled: StagedProgram, columns: Float[Array, "nodes variables"]) -> Scalar:
    largest = jnp.max(jnp.abs(columns * scaled.gradient))
    if scaled.norm is not None:
        largest = jnp.maximum(largest, jnp.max(scaled.norm.weight))
    # A cost without linear terms gives no hint: to take it for a tiny one would blow up the prices of the links.
    return 1.0 / jnp.where(largest > 0, jnp.clip(largest, _LOWEST, _HIGHEST), 1.0)


def _shrink(size: jax.Array) -> jax.Array:
    """1 / sqrt(size), and one for rows or columns that are empty."""
    return jnp.where(size > 1e-12, 1.0 / jnp.sqrt(jnp.maximum(size, 1e-12)), 1.0)


def scaled_by(program: StagedProgram, s: Scales) -> StagedProgram:
    """The program in the units of given scales; linear in its data, so that derivatives pass."""
    columns_before = jnp.concatenate([jnp.ones_like(s.columns[:1]), s.columns])
    columns_after = jnp.concatenate([s.columns, jnp.ones_like(s.columns[:1])])
    links = program.links
    # All soft rows of a link share one scale rho; |V nu| = |V rho nu| / rho keeps the cost unchanged.
    shared = jnp.max(jnp.where(links.soft > 0, s.links, 0.0), axis=1)
    shared = jnp.where(shared > 0, shared, 1.0)
    norm = program.norm
    if norm is not None:
        norm = NormCost(s.cost * norm.weight, norm.scale * s.columns, norm.centre / s.columns)
    return StagedProgram(
        hessian=s.cost * s.columns[:, :, None] * program.hessian * s.columns[:, None, :],
        gradient=s.cost * s.columns * program.gradient,
        links=CouplingRows(
            before=s.links[:, :, None] * links.before * columns_before[:, None, :],
            after=s.links[:, :, None] * links.after * columns_after[:, None, :],
            offset=s.links * links.offset,
            soft=links.soft,
            weight=s.cost * links.weight / shared,
        ),
        rows=HalfSpaceRows(
            s.rows[:, :, None] * program.rows.matrix * s.columns[:, None, :], s.rows * program.rows.offset
        ),
        cones=tuple(
            Cones(r[..., None, None] * cone.matrix * s.columns[:, None, None, :], r[..., None] * cone.offset)
            for cone, r in zip(program.cones, s.cones, strict=True)
        ),
        norm=norm,
    )
