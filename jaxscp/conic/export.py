"""A staged program as sparse matrices: min 1/2 x'Px + q'x subject to A x + s = b, s in K (CLARABEL's convention).

Variables x are all nodes' z, then the bounds xi of the trust-region norms, then the bounds zeta of the virtual
controls. Rows of A are, in this order: hard links (zero cone), half-spaces (nonnegative orthant), and the
second-order cones, each in its own block.
"""

from dataclasses import dataclass

import jax
import numpy as np
import scipy.sparse as sp

from jaxscp.conic.program import StagedProgram


@dataclass(frozen=True)
class SparseProgram:
    """Matrices and cone sizes of an exported program; only the rows that say something are kept."""

    P: sp.csc_matrix
    """Upper triangle of the cost's Hessian."""
    q: np.ndarray
    A: sp.csc_matrix
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


def export(program: StagedProgram) -> SparseProgram:
    """Export a concrete (not traced) program.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.conic import export
        >>> from jaxscp.conic.examples import smallest_program
        >>> export(smallest_program()).A.shape
        (4, 4)
    """
    p: StagedProgram = jax.tree.map(np.asarray, program)
    N, n = p.gradient.shape
    has_norm = p.norm is not None
    links = p.links
    xi_at, zeta_at = N * n, N * n + (N if has_norm else 0)
    total = zeta_at + N + 1

    # z of links' rows: E acts on the node before, F on the node after.
    chain = sp.lil_matrix(((N + 1) * links.offset.shape[1], total))
    m = links.offset.shape[1]
    for link in range(N + 1):
        at = slice(link * m, (link + 1) * m)
        if link > 0:
            chain[at, (link - 1) * n : link * n] = links.before[link]
        if link < N:
            chain[at, link * n : (link + 1) * n] = links.after[link]
    chain = chain.tocsr()
    hard = (links.soft == 0).ravel() & (np.diff(chain.indptr) > 0)

    rows = _node_rows(p.rows.matrix, total)
    meaningful = np.diff(rows.indptr) > 0
    blocks = [chain[hard], rows[meaningful]]
    rights = [links.offset.ravel()[hard], p.rows.offset.ravel()[meaningful]]
    sizes: list[int] = []
    for cone in p.cones:
        _, count, dimension, _ = cone.matrix.shape
        stacked = _node_rows(cone.matrix.reshape(N, count * dimension, n), total)
        used = np.abs(cone.matrix).max(axis=(2, 3)).ravel() > 0
        keep = np.repeat(used, dimension)
        blocks.append(stacked[keep])
        rights.append(cone.offset.ravel()[keep])
        sizes += [dimension] * int(used.sum())
    if p.norm is not None:
        scaled = sp.diags(p.norm.scale.ravel()) @ sp.eye(N * n, total, format="csr")
        for k in range(N):
            blocks += [_unit(xi_at + k, total), -scaled[k * n : (k + 1) * n]]
            rights += [np.zeros(1), -(p.norm.scale[k] * p.norm.centre[k])]
        sizes += [1 + n] * N
    for link in range(N + 1):
        soft = np.flatnonzero(links.soft[link] > 0)
        blocks += [_unit(zeta_at + link, total), chain[link * m + soft]]
        rights += [np.zeros(1), links.offset[link, soft]]
        sizes.append(1 + soft.size)
    q = np.concatenate([p.gradient.ravel(), p.norm.weight if p.norm is not None else [], links.weight])
    P = sp.block_diag([*p.hessian, sp.csc_matrix((total - N * n, total - N * n))], format="csc")
    A = sp.vstack(blocks, format="csc")
    A.eliminate_zeros()
    P = sp.triu(P, format="csc")
    P.eliminate_zeros()
    return SparseProgram(
        P, q, A, np.concatenate(rights), int(hard.sum()), int(meaningful.sum()), tuple(sizes), N, n
    )


def _node_rows(matrix: np.ndarray, total: int) -> sp.csr_matrix:
    """Block diagonal of the nodes' rows, widened to all variables."""
    block = sp.block_diag(list(matrix), format="csr")
    block.eliminate_zeros()
    block.resize(block.shape[0], total)
    return block


def _unit(column: int, total: int) -> sp.csr_matrix:
    """The row of A for the head of a cone: A x + s = 0 with s = x[column]."""
    return sp.csr_matrix(([-1.0], ([0], [column])), shape=(1, total))
