"""Sparse matrices of a staged program in CLARABEL's convention: min 1/2 x'Px + q'x, A x + s = b, s in K.

Variables x are z of all nodes, then the bounds xi of the trust-region norms. The cost W zeta of virtual control
follows, for each link with soft rows. Rows of A are hard rows of the links (zero cone), half-spaces (nonnegative
orthant) and second-order cones, each in its own block.

Rows of a link are multiplied by its penalty weight W, so that a residual of one costs one. General solvers stop on
residuals. With W = 1000, residuals of 1e-8 on thirty links change the optimal value by 3e-4. CLARABEL then stalls, or
stops far from the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import scipy

from jaxscp.conic.program import StagedProgram

Sparse = Any  # SciPy matrix; the stubs give its operations unions that no annotation fits
Numpy = Any  # part of a program, with NumPy arrays


@dataclass(frozen=True)
class SparseProgram:
    """Matrices and cone sizes of an exported program, without rows that hold for every z."""

    P: Sparse
    """Upper triangle of the cost's Hessian."""
    q: np.ndarray
    A: Sparse
    b: np.ndarray
    zero: int
    """Number of rows of the zero cone."""
    nonnegative: int
    """Number of rows of the nonnegative orthant."""
    second_order: tuple[int, ...]
    """Dimension of each second-order cone."""
    nodes: int
    variables: int

    def node_variables(self, x: np.ndarray) -> np.ndarray:
        """z of a solution vector, (nodes, variables)."""
        return np.asarray(x)[: self.nodes * self.variables].reshape(self.nodes, self.variables)


@dataclass(frozen=True)
class AffineRows:
    """Affine functions ``offset - matrix z`` of the variables of all nodes."""

    matrix: Sparse
    offset: np.ndarray
    origin: np.ndarray
    """Flat index of each row in its array of the staged program."""

    def select(self, index: np.ndarray) -> AffineRows:
        """Rows selected by a mask or an index."""
        return AffineRows(self.matrix[index], self.offset[index], self.origin[index])

    def recentred(self, centre: np.ndarray) -> AffineRows:
        """Same rows as functions of z - centre."""
        return AffineRows(self.matrix, self.offset - self.matrix @ centre, self.origin)


def export(program: StagedProgram) -> SparseProgram:
    """Sparse form of a concrete (not traced) program.

    Example:
        >>> from jaxscp.conic import export
        >>> from jaxscp.conic.random_programs import smallest_program
        >>> export(smallest_program()).A.shape
        (8, 5)
    """
    p = as_numpy(program)
    hard, soft = link_rows(p.links, link_scales(p.links))
    half_spaces = node_rows(p.rows)
    cones = [cone for group in p.cones for cone in cone_rows(group)]
    weights = p.links.weight / link_scales(p.links)
    if p.norm is not None:
        weights = np.concatenate([p.norm.weight, weights])
    norms = [
        (rows, weight) for rows, weight in zip(norm_rows(p) + soft, weights, strict=True) if rows.offset.size
    ]
    extra = len(norms)
    matrices = [_widen(rows.matrix, extra) for rows in (hard, half_spaces, *cones)]
    matrices += [_norm_cone(rows.matrix, bound, extra) for bound, (rows, _) in enumerate(norms)]
    offsets = [rows.offset for rows in (hard, half_spaces, *cones)]
    offsets += [np.concatenate([[0.0], rows.offset]) for rows, _ in norms]
    return SparseProgram(
        P=hessian(p, extra),
        q=np.concatenate([p.gradient.ravel(), [weight for _, weight in norms]]),
        A=scipy.sparse.vstack(matrices, format="csc"),
        b=np.concatenate(offsets),
        zero=hard.offset.size,
        nonnegative=half_spaces.offset.size,
        second_order=tuple(part.size for part in offsets[2:]),
        nodes=p.nodes,
        variables=p.variables,
    )


# --- parts that the quadratic form uses too ---


def as_numpy(program: StagedProgram) -> Numpy:
    """Program with NumPy arrays."""
    return jax.tree.map(np.asarray, program)


def hessian(p: Numpy, extra: int) -> Sparse:
    """Upper triangle of the cost's Hessian, with zeros for ``extra`` variables."""
    matrix = scipy.sparse.triu(
        scipy.sparse.block_diag([*p.hessian, scipy.sparse.csc_matrix((extra, extra))], format="csc"),
        format="csc",
    )
    matrix.eliminate_zeros()
    return matrix


def link_scales(links: Numpy) -> np.ndarray:
    """Factor of every link's rows: the penalty weight W, or one if W is zero."""
    return np.where(links.weight > 0, links.weight, 1.0)


def link_rows(links: Numpy, scale: np.ndarray) -> tuple[AffineRows, list[AffineRows]]:
    """Hard rows of all links, without rows 0 = 0, and the soft rows of each link; both times each link's scale."""
    rows, soft = _coupling_rows(links, scale[:, None]), links.soft > 0
    index = np.arange(soft.size).reshape(soft.shape)
    return rows.select(~soft.ravel() & _restricts(rows, rows.offset != 0)), [
        rows.select(index[link, soft[link]]) for link in range(len(soft))
    ]


def node_rows(rows: Numpy) -> AffineRows:
    """Half-spaces of all nodes, without those that hold for every z."""
    flat = _flat(_block_diagonal(rows.matrix), rows.offset)
    return flat.select(_restricts(flat, flat.offset < 0))


def cone_rows(cones: Numpy) -> list[AffineRows]:
    """Second-order cones of a group, one by one, without those that hold for every z."""
    _, _, dimension, variables = cones.matrix.shape
    flat = _flat(_block_diagonal(cones.matrix.reshape(len(cones.matrix), -1, variables)), cones.offset)
    offset = flat.offset.reshape(-1, dimension)
    outside = np.linalg.norm(offset[:, 1:], axis=1) > offset[:, 0]
    restricts = _restricts(flat, np.repeat(outside, dimension)).reshape(-1, dimension).any(axis=1)
    return [flat.select(dimension * cone + np.arange(dimension)) for cone in np.flatnonzero(restricts)]


def norm_rows(p: Numpy) -> list[AffineRows]:
    """Arguments D (z - r) of the trust region's norm at every node, without zero rows of D; [] without a norm."""
    if p.norm is None:
        return []
    rows = _flat(scipy.sparse.diags(p.norm.scale.ravel(), format="csr"), p.norm.scale * p.norm.centre)
    index = np.arange(p.norm.scale.size).reshape(p.norm.scale.shape)
    return [rows.select(index[node, p.norm.scale[node] != 0]) for node in range(p.nodes)]


def stack_rows(groups: list[AffineRows], columns: int) -> AffineRows:
    """Rows of all groups in one stack over ``columns`` variables."""
    matrix = scipy.sparse.vstack(
        [scipy.sparse.csr_matrix((0, columns)), *(rows.matrix for rows in groups)], format="csr"
    )
    join = lambda parts: np.concatenate([np.zeros(0), *parts])  # noqa: E731
    origin = join(rows.origin for rows in groups).astype(int)
    return AffineRows(matrix, join(rows.offset for rows in groups), origin)


def _coupling_rows(links: Numpy, scale: np.ndarray) -> AffineRows:
    """Rows of all links over all nodes: E multiplies node l - 1, F node l."""
    count = len(links.before)
    blocks: list[list[Sparse]] = [[None] * (count - 1) for _ in range(count)]
    for link in range(count):
        if link > 0:
            blocks[link][link - 1] = scipy.sparse.coo_matrix(scale[link] * links.before[link])
        if link < count - 1:
            blocks[link][link] = scipy.sparse.coo_matrix(scale[link] * links.after[link])
    matrix: Sparse = scipy.sparse.bmat(blocks, format="csr")
    matrix.eliminate_zeros()
    return _flat(matrix, scale * links.offset)


def _block_diagonal(blocks: np.ndarray) -> Sparse:
    matrix = scipy.sparse.block_diag([scipy.sparse.coo_matrix(block) for block in blocks], format="csr")
    matrix.eliminate_zeros()
    return matrix


def _flat(matrix: Sparse, offset: np.ndarray) -> AffineRows:
    return AffineRows(matrix, offset.ravel(), np.arange(offset.size))


def _restricts(rows: AffineRows, contradicts: np.ndarray) -> np.ndarray:
    """Whether each row restricts z. A row of zeros does so only if its offset contradicts it."""
    return (np.diff(rows.matrix.indptr) > 0) | contradicts


def _widen(matrix: Sparse, extra: int) -> Sparse:
    """Rows over ``extra`` more variables, with zero coefficients."""
    return scipy.sparse.hstack([matrix, scipy.sparse.csr_matrix((matrix.shape[0], extra))], format="csr")


def _norm_cone(matrix: Sparse, bound: int, extra: int) -> Sparse:
    """Rows of the second-order cone |offset - matrix z| <= (extra variable number ``bound``)."""
    head = scipy.sparse.csr_matrix(
        ([-1.0], ([0], [matrix.shape[1] + bound])), shape=(1, matrix.shape[1] + extra)
    )
    return scipy.sparse.vstack([head, _widen(matrix, extra)], format="csr")
