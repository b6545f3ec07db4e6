"""Quadratic form of a staged program: min 1/2 x'Px + q'x subject to l <= A x <= u (OSQP's convention).

Norms become polyhedral, each conservatively:

* A second-order cone of dimension 3 becomes a pyramid inside it, over a regular polygon with a given number of facets.
  A cone of another dimension becomes the 1-norm cone inside it, which is the same cone in dimension 2. A point that is
  feasible for the quadratic program is therefore feasible for the given program.
* Virtual control and the trust region cost their 1-norm, which is at least the Euclidean norm.

So the optimal value is an upper bound of the given program's. The trust region's centre is the origin of the variables,
since the solution lies near it: splitting methods, which start at zero, then need far fewer iterations.
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

DEFAULT_FACETS = (
    16  # of a pyramid, whose inner radius is 1 - cos(pi / 16), 2 per cent, smaller than the cone's
)
# Factor of the links' rows. An operator-splitting method has one penalty for all rows. On subproblems whose virtual
# control has penalty weight 1000, factors of 10 to 100 are best; 1 and 1000 are far slower.
LINK_SCALE = 30.0


@dataclass(frozen=True)
class _Block:
    """Inequalities ``combination (offset - matrix z) <= auxiliary a`` with the block's auxiliary variables a."""

    rows: AffineRows
    combination: Sparse
    auxiliary: Sparse
    """One column for each auxiliary variable, the absolute value of a row."""
    cost: np.ndarray
    """Cost of each auxiliary variable."""

    def multipliers(self, y: np.ndarray) -> np.ndarray:
        """Multipliers of the given program's rows: their contribution to stationarity."""
        return -(self.combination.T @ y)


@dataclass(frozen=True)
class QuadraticProgram:
    """Quadratic form; its variables are z - centre of all nodes, then the auxiliary variables of all blocks."""

    equalities: AffineRows
    """Hard rows of the links."""
    blocks: tuple[_Block, ...]
    """Inequalities: half-spaces, cones, trust region, virtual control."""
    P: Sparse
    """Upper triangle of the cost's Hessian."""
    q: np.ndarray
    centre: np.ndarray
    """Origin of the variables, (nodes, variables)."""
    constant: float
    """Cost at the centre, a constant term beside P and q."""
    program: Numpy
    """The given program, with NumPy arrays."""

    @cached_property
    def A(self) -> Sparse:
        """Constraint matrix."""
        of_z = [self.equalities.matrix, *(-(b.combination @ b.rows.matrix) for b in self.blocks)]
        of_equalities = scipy.sparse.csr_matrix((self.equalities.offset.size, 0))
        of_auxiliary = scipy.sparse.block_diag([of_equalities, *(-b.auxiliary for b in self.blocks)])
        return scipy.sparse.hstack([scipy.sparse.vstack(of_z), of_auxiliary], format="csc")

    @cached_property
    def u(self) -> np.ndarray:
        """Upper bounds."""
        return np.concatenate(
            [self.equalities.offset, *(-(b.combination @ b.rows.offset) for b in self.blocks)]
        )

    @cached_property
    def l(self) -> np.ndarray:  # noqa: E743
        """Lower bounds."""
        count = self.equalities.offset.size
        return np.concatenate([self.u[:count], np.full(self.u.size - count, -np.inf)])

    def objective(self, x: np.ndarray) -> float:
        """Cost of a vector of all variables."""
        hessian_x = self.P @ x + self.P.T @ x - self.P.diagonal() * x
        return float(0.5 * x @ hessian_x + self.q @ x) + self.constant

    def node_variables(self, x: np.ndarray) -> np.ndarray:
        """z of a solution vector, (nodes, variables)."""
        return self.centre + x[: self.centre.size].reshape(self.centre.shape)

    def multipliers(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...]]:
        """Multipliers of the given program's links, half-spaces and cones, from the multipliers of A's rows.

        Each multiplier is its row's contribution to stationarity. For hard rows, half-spaces and cones, this is the
        usual multiplier. For soft rows, each component is bounded by the penalty weight; the given program bounds the
        Euclidean norm instead. The trust region's multipliers are left out.
        """
        p = self.program
        links, rows = np.zeros(p.links.offset.size), np.zeros(p.rows.offset.size)
        cones = [np.zeros(group.offset.size) for group in p.cones]
        targets = [rows, *(y for y, group in zip(cones, p.cones, strict=True) for _ in cone_rows(group))]
        targets += [np.zeros(p.gradient.size), links]
        sizes = [self.equalities.offset.size, *(b.combination.shape[0] for b in self.blocks[:-1])]
        parts = np.split(y, np.cumsum(sizes))
        links[self.equalities.origin] = parts[0]
        for target, block, part in zip(targets, self.blocks, parts[1:], strict=True):
            target[block.rows.origin] = block.multipliers(part)
        return (
            LINK_SCALE * links.reshape(p.links.offset.shape),
            rows.reshape(p.rows.offset.shape),
            tuple(cone.reshape(group.offset.shape) for cone, group in zip(cones, p.cones, strict=True)),
        )


def quadratic_form(program: StagedProgram, facets: int = DEFAULT_FACETS) -> QuadraticProgram:
    """Quadratic form of a concrete (not traced) program.

    Args:
        program: the program to approximate.
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
    blocks.append(_one_norms(norm_rows(p), [] if p.norm is None else p.norm.weight, p.gradient.size))
    blocks.append(_one_norms(soft, p.links.weight / LINK_SCALE, p.gradient.size))
    cost = np.concatenate([block.cost for block in blocks])
    hessian_centre = np.einsum("kij,kj->ki", p.hessian, centre)
    return QuadraticProgram(
        equalities=hard.recentred(centre.ravel()),
        blocks=tuple(replace(block, rows=block.rows.recentred(centre.ravel())) for block in blocks),
        P=hessian(p, cost.size),
        q=np.concatenate([(p.gradient + hessian_centre).ravel(), cost]),
        centre=centre,
        constant=float(np.vdot(p.gradient + 0.5 * hessian_centre, centre)),
        program=p,
    )


def _half_spaces(rows: AffineRows) -> _Block:
    count = rows.offset.size
    return _Block(
        rows, -scipy.sparse.eye(count, format="csr"), scipy.sparse.csr_matrix((count, 0)), np.zeros(0)
    )


def _one_norms(groups: list[AffineRows], weights, columns: int) -> _Block:
    """Weighted 1-norms of groups of rows: |row| <= a, at the weight of its group."""
    rows = stack_rows(groups, columns)
    eye = scipy.sparse.eye(rows.offset.size, format="csr")
    cost = np.repeat(np.asarray(weights, float), [group.offset.size for group in groups])
    return _Block(
        rows,
        scipy.sparse.vstack([eye, -eye], format="csr"),
        scipy.sparse.vstack([eye, eye], format="csr"),
        cost,
    )


def _cone(rows: AffineRows, facets: int) -> _Block:
    return _pyramid(rows, facets) if rows.offset.size == 3 else _one_norm_cone(rows)


def _pyramid(rows: AffineRows, facets: int) -> _Block:
    """Pyramid n_i . v <= t cos(pi / facets), inscribed in |v| <= t, for unit normals n_i at equal angles."""
    angle = 2.0 * np.pi * np.arange(facets) / facets
    head = np.full(facets, -np.cos(np.pi / facets))
    combination = scipy.sparse.csr_matrix(np.stack([head, np.cos(angle), np.sin(angle)], axis=1))
    return _Block(rows, combination, scipy.sparse.csr_matrix((facets, 0)), np.zeros(0))


def _one_norm_cone(rows: AffineRows) -> _Block:
    """1-norm cone |v_j| <= a_j, sum a_j <= t, inscribed in |v| <= t."""
    tail = rows.offset.size - 1
    eye, column = np.eye(tail), np.zeros((tail, 1))
    combination = np.block([[column, eye], [column, -eye], [-np.ones((1, 1)), np.zeros((1, tail))]])
    auxiliary = np.concatenate([eye, eye, -np.ones((1, tail))])
    return _Block(
        rows, scipy.sparse.csr_matrix(combination), scipy.sparse.csr_matrix(auxiliary), np.zeros(tail)
    )
