"""Ruiz equilibration with the program's structure: largest entries of columns, rows and cost become about one.

All rows of a second-order cone share one scale. So do the soft rows of a link, because one Euclidean norm measures
their virtual control. Hard rows and half-spaces have a scale each.
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

_LOWEST, _HIGHEST = 1e-4, 1e4  # limits of each scale, as in OSQP and Clarabel
_EMPTY = 1e-12  # largest entry below which a row or column counts as empty


class Scales(eqx.Module):
    """Scales of an equilibrated program: factors of its columns, rows and cost."""

    columns: Float[Array, "nodes variables"]
    """z of the given program = columns * z of the equilibrated program."""
    links: Float[Array, "links link_rows"]
    """Factors of the links' rows."""
    rows: Float[Array, "nodes rows"]
    """Factors of the half-spaces."""
    cones: tuple[Float[Array, "nodes _"], ...]
    """Factors of the user's second-order cones, one array a group."""
    cost: Scalar
    """Factor of the cost."""

    def restore(
        self, z: Float[Array, "nodes variables"], multipliers: ConicMultipliers
    ) -> tuple[Float[Array, "nodes variables"], ConicMultipliers]:
        """Solution (z, multipliers) in the user's units, from the one of the equilibrated program."""
        cones = tuple(
            y * r[..., None] / self.cost for y, r in zip(multipliers.cones, self.cones, strict=True)
        )
        return self.columns * z, ConicMultipliers(
            multipliers.links * self.links / self.cost, multipliers.rows * self.rows / self.cost, cones
        )

    def apply(self, warm_start: WarmStart) -> WarmStart:
        """Warm start in equilibrated units, from one in the user's units."""
        y = warm_start.multipliers
        cones = tuple(v * self.cost / r[..., None] for v, r in zip(y.cones, self.cones, strict=True))
        multipliers = ConicMultipliers(
            y.links * self.cost / self.links, y.rows * self.cost / self.rows, cones
        )
        return WarmStart(warm_start.z / self.columns, multipliers, warm_start.available)


def equilibrate(program: StagedProgram, rounds: int = 3) -> tuple[StagedProgram, Scales]:
    """Equilibrated program and its scales.

    ``Scales.restore`` converts the solution back. That solution does not depend on the scales, so they have no
    derivative.
    """
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
    # A loop, because XLA would recompute a round for each of its uses in the next one.
    return jax.lax.fori_loop(0, rounds, lambda _, s: _refine(scaled_by(program, s), s), scales)


def _refine(scaled: StagedProgram, scales: Scales) -> Scales:
    """Scales after one more Ruiz round: every row and column divided by the root of its largest entry."""
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
    """1 / (largest entry of the linear cost), limited."""
    largest = jnp.max(jnp.abs(columns * scaled.gradient))
    if scaled.norm is not None:
        largest = jnp.maximum(largest, jnp.max(scaled.norm.weight))
    # Without linear terms the cost has no known size. A tiny size would inflate the penalty weights of the links.
    return 1.0 / jnp.where(largest > 0, jnp.clip(largest, _LOWEST, _HIGHEST), 1.0)


def _shrink(size: jax.Array) -> jax.Array:
    """1 / sqrt(size); one for empty rows and columns."""
    return jnp.where(size > _EMPTY, 1.0 / jnp.sqrt(jnp.maximum(size, _EMPTY)), 1.0)


def scaled_by(program: StagedProgram, s: Scales) -> StagedProgram:
    """Program in the units of given scales; differentiable, as it is linear in the program's data."""
    columns_before = jnp.concatenate([jnp.ones_like(s.columns[:1]), s.columns])
    columns_after = jnp.concatenate([s.columns, jnp.ones_like(s.columns[:1])])
    links = program.links
    # All soft rows of a link share one scale rho: |V nu| = |V rho nu| / rho preserves the cost.
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
