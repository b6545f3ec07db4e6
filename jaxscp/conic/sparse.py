"""A staged program as sparse matrices in CLARABEL's convention: min 1/2 x'Px + q'x, A x + s = b, s in K.

Variables x are all nodes' z, then the bounds xi of the trust-region norms, then for each link that has some
the cost W zeta of its virtual control. Rows of A are, in this order: hard links (zero cone), half-spaces
(nonnegative orthant), and the second-order cones, each in its own block.

Rows of a link are multiplied by the price W of its virtual control, so that a residual of one costs one.
General solvers stop on residuals: at a price of 1000 one of 1e-8 on each of thirty links moves the optimal
value by 3e-4, and CLARABEL then stalls or stops far from the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import scipy

from jaxscp.conic.program import StagedProgram

Sparse = Any  # a SciPy matrix; the stubs give its operations unions that no annotation fits
Numpy = Any  # a part of a program whose arrays are NumPy's


@dataclass(frozen=True)
class SparseProgram:
    """Matrices and cone sizes of an exported program; only the rows that say something are kept."""

    P: Sparse
    """Upper triangle of the cost's Hessian."""
    q: np.ndarray
    A: Sparse
    b: np.ndarray
    zero: int
    """Rows of the zero cone."""
    nonnegative: int
    """Rows of the nonnegative orthant."""
    second_order: tuple[int, ...]
    """Dimension of each second-order cone."""
    nodes: int
    variables: int

    def node_variables(self, x: np.ndarray) -> np.ndarray:
        """z of a solution vector, (nodes, variables)."""
        return np.asarray(x)[: self.nodes * self.variables].reshape(self.nodes, self.variables)


@dataclass(frozen=True)
class AffineRows:
    """``offset - matrix z``: a stack of rows over all nodes' variables."""

    matrix: Sparse
    offset: np.ndarray
    origin: np.ndarray
    """Position of each row in the array of the staged program that it comes from, counted flat."""

    def keep(self, wanted: np.ndarray) -> AffineRows:
        """The rows that a mask or an index selects."""
        return AffineRows(self.matrix[wanted], self.offset[wanted], self.origin[wanted])

    def about(self, centre: np.ndarray) -> AffineRows:
        """The same rows as functions of z - centre."""
        return AffineRows(self.matrix, self.offset - self.matrix @ centre, self.origin)


def export(program: StagedProgram) -> SparseProgram:
    """Export a concrete (not traced) program.

    Example:
        >>> from jaxscp.conic import export
        >>> from jaxscp.conic.random_programs import smallest_program
        >>> export(smallest_program()).A.shape
        (8, 5)
    """
    p = as_numpy(program)
    hard, soft = link_rows(p.links, link_prices(p.links))
    half_spaces = node_rows(p.rows)
    cones = [cone for group in p.cones for cone in cone_rows(group)]
    prices = p.links.weight / link_prices(p.links)
    if p.norm is not None:
        prices = np.concatenate([p.norm.weight, prices])
    norms = [
        (rows, price) for rows, price in zip(norm_rows(p) + soft, prices, strict=True) if rows.offset.size
    ]
    extra = len(norms)
    flat = [_widen(rows.matrix, extra) for rows in (hard, half_spaces, *cones)]
    flat += [_bounded(rows.matrix, bound, extra) for bound, (rows, _) in enumerate(norms)]
    right = [rows.offset for rows in (hard, half_spaces, *cones)]
    right += [np.concatenate([[0.0], rows.offset]) for rows, _ in norms]
    return SparseProgram(
        P=hessian(p, extra),
        q=np.concatenate([p.gradient.ravel(), [price for _, price in norms]]),
        A=scipy.sparse.vstack(flat, format="csc"),
        b=np.concatenate(right),
        zero=hard.offset.size,
        nonnegative=half_spaces.offset.size,
        second_order=tuple(part.size for part in right[2:]),
        nodes=p.nodes,
        variables=p.variables,
    )


# --- the parts, which the quadratic form shares ---


def as_numpy(program: StagedProgram) -> Numpy:
    """The same program with NumPy arrays."""
    return jax.tree.map(np.asarray, program)


def hessian(p: Numpy, extra: int) -> Sparse:
    """Upper triangle of the cost's Hessian, with ``extra`` variables that it leaves out."""
    matrix = scipy.sparse.triu(
        scipy.sparse.block_diag([*p.hessian, scipy.sparse.csc_matrix((extra, extra))], format="csc"),
        format="csc",
    )
    matrix.eliminate_zeros()
    return matrix


def link_prices(links: Numpy) -> np.ndarray:
    """W of every link, one where it is zero: what its rows are multiplied by."""
    return np.where(links.weight > 0, links.weight, 1.0)


def link_rows(links: Numpy, scale: np.ndarray) -> tuple[AffineRows, list[AffineRows]]:
    """Hard rows of all links that say something, and the soft rows of each, times the scale of each link."""
    rows, soft = _chain(links, scale[:, None]), links.soft > 0
    index = np.arange(soft.size).reshape(soft.shape)
    return rows.keep(~soft.ravel() & _says(rows, rows.offset != 0)), [
        rows.keep(index[link, soft[link]]) for link in range(len(soft))
    ]


def node_rows(rows: Numpy) -> AffineRows:
    """Half-spaces of all nodes, less those that hold everywhere."""
    flat = _flat(_block_diagonal(rows.matrix), rows.offset)
    return flat.keep(_says(flat, flat.offset < 0))


def cone_rows(cones: Numpy) -> list[AffineRows]:
    """Each second-order cone of a group, less those that hold everywhere."""
    _, _, dimension, variables = cones.matrix.shape
    flat = _flat(_block_diagonal(cones.matrix.reshape(len(cones.matrix), -1, variables)), cones.offset)
    offset = flat.offset.reshape(-1, dimension)
    outside = np.linalg.norm(offset[:, 1:], axis=1) > offset[:, 0]
    says = _says(flat, np.repeat(outside, dimension)).reshape(-1, dimension).any(axis=1)
    return [flat.keep(dimension * cone + np.arange(dimension)) for cone in np.flatnonzero(says)]


def norm_rows(p: Numpy) -> list[AffineRows]:
    """What the trust region measures at every node, less components that it leaves out; none without one."""
    if p.norm is None:
        return []
    rows = _flat(scipy.sparse.diags(p.norm.scale.ravel(), format="csr"), p.norm.scale * p.norm.centre)
    index = np.arange(p.norm.scale.size).reshape(p.norm.scale.shape)
    return [rows.keep(index[node, p.norm.scale[node] != 0]) for node in range(p.nodes)]


def stack_rows(groups: list[AffineRows], columns: int) -> AffineRows:
    """All groups' rows as one stack over ``columns`` variables."""
    matrix = scipy.sparse.vstack(
        [scipy.sparse.csr_matrix((0, columns)), *(rows.matrix for rows in groups)], format="csr"
    )
    join = lambda parts: np.concatenate([np.zeros(0), *parts])  # noqa: E731
    origin = join(rows.origin for rows in groups).astype(int)
    return AffineRows(matrix, join(rows.offset for rows in groups), origin)


def _chain(links: Numpy, scale: np.ndarray) -> AffineRows:
    """Rows of all links over all nodes: E acts on the node before, F on the node after."""
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
    matrix = scipy.sparse.block_diag(list(blocks), format="csr")
    matrix.eliminate_zeros()
    return matrix


def _flat(matrix: Sparse, offset: np.ndarray) -> AffineRows:
    return AffineRows(matrix, offset.ravel(), np.arange(offset.size))


def _says(rows: AffineRows, contradicts: np.ndarray) -> np.ndarray:
    """Whether each row says anything: one of zeros does only if its offset alone contradicts it."""
    return (np.diff(rows.matrix.indptr) > 0) | contradicts


def _widen(matrix: Sparse, extra: int) -> Sparse:
    """The same rows over ``extra`` more variables."""
    return scipy.sparse.hstack([matrix, scipy.sparse.csr_matrix((matrix.shape[0], extra))], format="csr")


def _bounded(matrix: Sparse, bound: int, extra: int) -> Sparse:
    """Rows of the cone in which one of the extra variables bounds a norm."""
    head = scipy.sparse.csr_matrix(
        ([-1.0], ([0], [matrix.shape[1] + bound])), shape=(1, matrix.shape[1] + extra)
    )
    return scipy.sparse.vstack([head, _widen(matrix, extra)], format="csr")
