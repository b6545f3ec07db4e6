"""Derivatives of the central path's conditions as one symmetric matrix of bounded entries, factored.

On the path, s and y are functions of t = s - y with D = ds/dt (``smoothing``). The conditions are P x + q + A'y = 0 and
A x + s = b. With B = (I - D)^1/2 and dy = B v, their derivatives are

    [ P    A'B ] [dx]
    [ BA   -D  ] [v ].

Its entries are bounded by the program's own at any mu. (Entries of the interior point's KKT matrix grow as 1 / mu.) A
node needs no curvature of its own, because a small regularisation makes the matrix quasidefinite. All rows and the
bounds of the norms are eliminated at once, and a block tridiagonal matrix in the nodes remains. Iterative refinement
removes the effect of the regularisation.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.cones.product import ConeVector
from jaxscp.conic import conic_form
from jaxscp.conic.conic_form import Primal
from jaxscp.conic.program import StagedProgram
from jaxscp.conic.smoothing import CentralPair, Spectrum, apply
from jaxscp.core.trees import tree_axpy, tree_max
from jaxscp.core.types import Scalar
from jaxscp.linalg import block_tridiagonal
from jaxscp.linalg.batched import gram

Unknowns = tuple[Primal, ConeVector]

# The root of the unit roundoff balances the perturbation by the regularisation and the rounding that it amplifies.
_REGULARISATION = 1e-8
_REFINED = 1e-14  # relative residual at which refinement ends
_PROGRESS = 0.5  # factor by which a round of refinement must reduce the residual
_TINY = 1e-300  # keeps the relative residual of a zero right-hand side finite


class AugmentedSystem(eqx.Module):
    """The matrix at one point of the path, factored."""

    program: StagedProgram
    pair: CentralPair
    root: Spectrum
    """B."""
    weight: Spectrum
    """(D + regularisation)^-1."""
    bound: Float[Array, "cones"]
    """Inverse curvature of the bounds xi and zeta; zero for the user's cones."""
    coupling: Float[Array, "cones tail"]
    """Derivatives of the bound of a norm with respect to the norm's arguments."""
    factor: block_tridiagonal.BlockCholesky

    def times(self, u: Unknowns) -> Unknowns:
        """Product with the matrix, without regularisation."""
        x, v = u
        hessian = conic_form.times_hessian(self.program, x)
        transposed = conic_form.times_constraints_transpose(self.program, self.scaled(v))
        first = tree_axpy(1.0, hessian, transposed)
        row = self.scaled(conic_form.times_constraints(self.program, x))
        return first, tree_axpy(-1.0, apply(self.pair.slack_derivative, self.pair.unit, v), row)

    def scaled(self, v: ConeVector) -> ConeVector:
        """B v."""
        return apply(self.root, self.pair.unit, v)

    def solve(self, rhs: Unknowns) -> tuple[Unknowns, Scalar]:
        """Solution, refined while refinement helps, and its residual relative to the right-hand side."""
        size = jnp.maximum(tree_max(rhs), _TINY)

        def unfinished(state):
            _, _, error, before = state
            return (error > _REFINED) & (error <= _PROGRESS * before)

        def refine(state):
            u, residual, error, _ = state
            u = tree_axpy(1.0, self._solve_regularised(residual), u)
            residual = tree_axpy(-1.0, self.times(u), rhs)
            return u, residual, tree_max(residual) / size, error

        start = jax.tree.map(jnp.zeros_like, rhs)
        u, _, error, _ = jax.lax.while_loop(
            unfinished, refine, (start, rhs, tree_max(rhs) / size, jnp.full_like(size, 2.0))
        )
        return u, error

    def _solve_regularised(self, rhs: Unknowns) -> Unknowns:
        rx, rv = rhs
        row = apply(_product(self.root, self.weight), self.pair.unit, rv)
        gradient = tree_axpy(1.0, conic_form.times_constraints_transpose(self.program, row), rx)
        bounds = _bounds_of_cones(self.program, gradient)
        shift = _cone_vector_of_tails(row, self.coupling * bounds[:, None])
        shift = conic_form.times_constraints_transpose(self.program, shift)
        z = block_tridiagonal.solve(self.factor, gradient.z + shift.z)
        x = Primal(z, jnp.zeros_like(rx.xi), jnp.zeros_like(rx.zeta))
        tails = conic_form.times_constraints(self.program, x).second[:, 1:]
        bounds = self.bound * bounds + jnp.sum(self.coupling * tails, axis=1)
        _, xi, zeta = _split_groups(self.program, bounds)
        x = Primal(z, xi, zeta)
        row = self.scaled(conic_form.times_constraints(self.program, x))
        return x, apply(self.weight, self.pair.unit, tree_axpy(-1.0, rv, row))


def factorise(program: StagedProgram, pair: CentralPair) -> AugmentedSystem:
    """Factored matrix: rows eliminated first, then the bounds of the norms, then the nodes."""
    weight = jax.tree.map(lambda d: 1.0 / (d + _REGULARISATION), pair.slack_derivative)
    root = jax.tree.map(jnp.sqrt, pair.multiplier_derivative)
    theta = _product(pair.multiplier_derivative, weight)
    mean, half = 0.5 * (theta.plus + theta.minus), 0.5 * (theta.plus - theta.minus)
    user, xi, zeta = _split_groups(program, jnp.ones_like(mean))
    has_bound = jnp.concatenate([*(jnp.zeros_like(v) for v in user), xi, zeta])
    bound = has_bound / (mean + _REGULARISATION)
    coupling = (half * bound)[:, None] * pair.unit
    # Tail alone after its bound is eliminated: mean - half^2 / (mean + regularisation), without cancellation.
    along = (theta.plus * theta.minus + _REGULARISATION * mean) / (mean + _REGULARISATION)
    factor = block_tridiagonal.factor(*_blocks(program, theta, along, pair.unit))
    return AugmentedSystem(program, pair, root, weight, bound, coupling, factor)


def _blocks(program: StagedProgram, theta: Spectrum, along: Float[Array, "cones"], unit):
    """Diagonal blocks of the reduced matrix in the nodes' variables, and the blocks to their right."""
    n = program.variables
    diagonal = program.hessian + _REGULARISATION * jnp.eye(n, dtype=along.dtype)
    diagonal += gram(program.rows.matrix, theta.orthant[..., None] * program.rows.matrix)
    tails = _along_and_across(theta.across, along, unit)
    user, _, _ = _split_groups(program, _cone_matrices(theta, unit))
    for cone, block in zip(program.cones, user, strict=True):
        nodes, count, dimension, _ = cone.matrix.shape
        block = block[:, :dimension, :dimension].reshape(nodes, count, dimension, dimension)
        diagonal += jnp.einsum("kcin,kcij,kcjm->knm", cone.matrix, block, cone.matrix)
    _, trust, virtual = _split_groups(program, tails)
    if program.norm is not None:
        scale = program.norm.scale
        diagonal += scale[:, :, None] * trust[:, :n, :n] * scale[:, None, :]
    links = program.links
    m, soft, hard = links.soft.shape[1], links.soft, (1.0 - links.soft) ** 2 / _REGULARISATION
    block = soft[:, :, None] * virtual[:, :m, :m] * soft[:, None, :] + hard[:, :, None] * jnp.eye(
        m, dtype=hard.dtype
    )
    after, before = block[:-1] @ links.after[:-1], block[1:] @ links.before[1:]
    diagonal += gram(links.after[:-1], after) + gram(links.before[1:], before)
    above = gram(links.before[1:-1], block[1:-1] @ links.after[1:-1])
    return diagonal, jnp.concatenate([above, jnp.zeros_like(diagonal[:1])])


def _along_and_across(
    across: Float[Array, "cones"], along: Float[Array, "cones"], unit: Float[Array, "cones tail"]
):
    """across (I - uu') + along uu'."""
    eye = jnp.eye(unit.shape[1], dtype=unit.dtype)
    outer = unit[:, :, None] * unit[:, None, :]
    return across[:, None, None] * (eye - outer) + along[:, None, None] * outer


def _cone_matrices(
    theta: Spectrum, unit: Float[Array, "cones tail"]
) -> Float[Array, "cones dimension dimension"]:
    """Matrices of a spectrum on the second-order cones."""
    mean, half = 0.5 * (theta.plus + theta.minus), 0.5 * (theta.plus - theta.minus)
    side = half[:, None, None] * unit[:, :, None]
    top = jnp.concatenate([mean[:, None, None], jnp.swapaxes(side, 1, 2)], axis=2)
    bottom = jnp.concatenate([side, _along_and_across(theta.across, mean, unit)], axis=2)
    return jnp.concatenate([top, bottom], axis=1)


def _split_groups(program: StagedProgram, v: Array):
    """Parts of an array over all second-order cones: (user's groups, trust region, virtual control)."""
    sizes = [cone.offset.shape[0] * cone.offset.shape[1] for cone in program.cones]
    sizes.append(0 if program.norm is None else program.nodes)
    *user, trust, virtual = jnp.split(v, np.cumsum(sizes))
    return user, trust, virtual


def _bounds_of_cones(program: StagedProgram, x: Primal) -> Float[Array, "cones"]:
    """Bounds (xi, zeta) in the order of the cones; zero for the user's cones."""
    users = sum(cone.offset.shape[0] * cone.offset.shape[1] for cone in program.cones)
    return jnp.concatenate([jnp.zeros((users,), x.z.dtype), x.xi, x.zeta])


def _cone_vector_of_tails(like: ConeVector, tail: Float[Array, "cones tail"]) -> ConeVector:
    """Vector with the given tails and zeros elsewhere."""
    second = jnp.concatenate([jnp.zeros_like(tail[:, :1]), tail], axis=1)
    return ConeVector(jnp.zeros_like(like.zero), jnp.zeros_like(like.orthant), second)


def _product(a: Spectrum, b: Spectrum) -> Spectrum:
    """Product of two maps with the same u."""
    return jax.tree.map(jnp.multiply, a, b)
