"""A staged program as a quadratic program: min 1/2 x'Px + q'x subject to l <= A x <= u (OSQP's convention).

Norms become polyhedral, each from the safe side:

* a second-order cone of dimension 3 becomes the pyramid inside it over a regular polygon with a stated number
  of facets; one of another dimension becomes the 1-norm cone inside it (the same cone, in dimension 2). What
  the quadratic program allows, the given program allows;
* virtual control and the trust region are priced by the 1-norm, which is never less than the Euclidean one.

So its optimal value is an upper bound of the given program's. Variables are measured from the trust region's
centre, near which the solution lies: splitting methods, which start at zero, then need far fewer iterations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from jaxscp.conic.program import StagedProgram
from jaxscp.conic.sparse import (
    AffineRows,
    Numpy,
    Sparse,
    as_numpy,
    cone_rows,
    hessian,
    link_rows,
    node_rows,
    norm_rows,
    stack_rows,
)

DEFAULT_FACETS = 16  # of the pyramid in a cone: it loses 1 - cos(pi / 16), 2 per cent, of the radius
# Rows of the links are multiplied by this. An operator-splitting method weighs all rows by one penalty: on
# subproblems with a price of 1000 for virtual control, 10 to 100 serve best; 1 and 1000 are far slower.
LINK_SCALE = 30.0


@dataclass(frozen=True)
class _Block:
    """Inequalities ``mix (offset - matrix z) <= own a`` over rows of the program and the block's own a."""

    rows: AffineRows
    mix: Sparse
    own: Sparse
    """One column for each of a, the block's further variables: absolute values of rows."""
    cost: np.ndarray
    """Price of each of a."""

    def multipliers(self, y: np.ndarray) -> np.ndarray:
        """Multipliers of the given program's rows: what they contribute to stationarity."""
        return -(self.mix.T @ y)


@dataclass(frozen=True)
class QuadraticProgram:
    """The quadratic form; its variables are all nodes' z - centre, then absolute values of rows in norms."""

    hard: AffineRows
    """Equalities."""
    blocks: tuple[_Block, ...]
    """Inequalities: half-spaces, cones, trust region, virtual control."""
    P: Sparse
    """Upper triangle of the cost's Hessian."""
    q: np.ndarray
    centre: np.ndarray
    """(nodes, variables): the z that zero stands for."""
    constant: float
    """Cost of the centre, which P and q leave out."""
    program: Numpy
    """The given program, in NumPy."""

    @cached_property
    def A(self) -> Sparse:
        """Constraint matrix."""
        of_z = scipy.sparse.vstack([self.hard.matrix, *(-(b.mix @ b.rows.matrix) for b in self.blocks)])
        none = scipy.sparse.csr_matrix((self.hard.offset.size, 0))
        return scipy.sparse.hstack(
            [of_z, scipy.sparse.block_diag([none, *(-b.own for b in self.blocks)])], format="csc"
        )

    @cached_property
    def u(self) -> np.ndarray:
        """Upper bounds."""
        return np.concatenate([self.hard.offset, *(-(b.mix @ b.rows.offset) for b in self.blocks)])

    @cached_property
    def l(self) -> np.ndarray:  # noqa: E743
        """Lower bounds."""
        equalities = self.hard.offset.size
        return np.concatenate([self.u[:equalities], np.full(self.u.size - equalities, -np.inf)])

    def objective(self, x: np.ndarray) -> float:
        """Cost of a vector of all variables."""
        curved = self.P @ x + self.P.T @ x - self.P.diagonal() * x
        return float(0.5 * x @ curved + self.q @ x) + self.constant

    def node_variables(self, x: np.ndarray) -> np.ndarray:
        """z of a solution vector, (nodes, variables)."""
        return self.centre + x[: self.centre.size].reshape(self.centre.shape)

    def multipliers(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...]]:
        """Multipliers of the given program's links, half-spaces and cones from those of the rows of A.

        Each is what its row contributes to stationarity, so that those of hard links, half-spaces and cones
        are multipliers in the usual sense; those of soft links are bounded by the price component by
        component, where the given program bounds their Euclidean norm. The trust region's have no place here.
        """
        p = self.program
        links, rows = np.zeros(p.links.offset.size), np.zeros(p.rows.offset.size)
        cones = [np.zeros(group.offset.size) for group in p.cones]
        owners = [rows, *(cone for cone, group in zip(cones, p.cones, strict=True) for _ in cone_rows(group))]
        owners += [np.zeros(p.gradient.size), links]
        parts = np.split(y, np.cumsum([self.hard.offset.size, *(b.mix.shape[0] for b in self.blocks[:-1])]))
        links[self.hard.origin] = parts[0]
        for owner, block, part in zip(owners, self.blocks, parts[1:], strict=True):
            owner[block.rows.origin] = block.multipliers(part)
        return (
            LINK_SCALE * links.reshape(p.links.offset.shape),
            rows.reshape(p.rows.offset.shape),
            tuple(cone.reshape(group.offset.shape) for cone, group in zip(cones, p.cones, strict=True)),
        )


def quadratic_form(program: StagedProgram, facets: int = DEFAULT_FACETS) -> QuadraticProgram:
    """The quadratic form of a concrete (not traced) program.

    Args:
        program: what to approximate.
        facets: sides of the pyramid in each cone of dimension 3.

    Example:
        >>> from jaxscp.conic.random_programs import smallest_program
        >>> from jaxscp.conic.quadratic import quadratic_form
        >>> quadratic_form(smallest_program()).A.shape
        (8, 5)
    """
    p = as_numpy(program)
    centre = np.zeros_like(p.gradient) if p.norm is None else np.where(p.norm.scale != 0, p.norm.centre, 0.0)
    hard, soft = link_rows(p.links, np.full(len(p.links.weight), LINK_SCALE))
    blocks = [_half_spaces(node_rows(p.rows))]
    blocks += [_cone(rows, facets) for group in p.cones for rows in cone_rows(group)]
    blocks.append(_absolute(norm_rows(p), [] if p.norm is None else p.norm.weight, p.gradient.size))
    blocks.append(_absolute(soft, p.links.weight / LINK_SCALE, p.gradient.size))
    own = np.concatenate([block.cost for block in blocks])
    curved = np.einsum("kij,kj->ki", p.hessian, centre)
    return QuadraticProgram(
        hard=hard.about(centre.ravel()),
        blocks=tuple(replace(block, rows=block.rows.about(centre.ravel())) for block in blocks),
        P=hessian(p, own.size),
        q=np.concatenate([(p.gradient + curved).ravel(), own]),
        centre=centre,
        constant=float(np.vdot(p.gradient + 0.5 * curved, centre)),
        program=p,
    )


def _half_spaces(rows: AffineRows) -> _Block:
    count = rows.offset.size
    return _Block(
        rows, -scipy.sparse.eye(count, format="csr"), scipy.sparse.csr_matrix((count, 0)), np.zeros(0)
    )


def _absolute(groups: list[AffineRows], prices, columns: int) -> _Block:
    """Bound the absolute value of every row, at the price of its group."""
    rows = stack_rows(groups, columns)
    eye = scipy.sparse.eye(rows.offset.size, format="csr")
    cost = np.repeat(np.asarray(prices, float), [group.offset.size for group in groups])
    return _Block(
        rows,
        scipy.sparse.vstack([eye, -eye], format="csr"),
        scipy.sparse.vstack([eye, eye], format="csr"),
        cost,
    )


def _cone(rows: AffineRows, facets: int) -> _Block:
    return _pyramid(rows, facets) if rows.offset.size == 3 else _one_norm_cone(rows)


def _pyramid(rows: AffineRows, facets: int) -> _Block:
    """n_i . v <= t cos(pi / facets) for unit normals n_i all around: inscribed in |v| <= t."""
    angle = 2.0 * np.pi * np.arange(facets) / facets
    head = np.full(facets, -np.cos(np.pi / facets))
    mix = scipy.sparse.csr_matrix(np.stack([head, np.cos(angle), np.sin(angle)], axis=1))
    return _Block(rows, mix, scipy.sparse.csr_matrix((facets, 0)), np.zeros(0))


def _one_norm_cone(rows: AffineRows) -> _Block:
    """|v_j| <= a_j and sum a_j <= t."""
    tail = rows.offset.size - 1
    eye, column = np.eye(tail), np.zeros((tail, 1))
    mix = np.block([[column, eye], [column, -eye], [-np.ones((1, 1)), np.zeros((1, tail))]])
    own = np.concatenate([eye, eye, -np.ones((1, tail))])
    return _Block(rows, scipy.sparse.csr_matrix(mix), scipy.sparse.csr_matrix(own), np.zeros(tail))
