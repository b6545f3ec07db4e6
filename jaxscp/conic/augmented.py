"""The derivatives of the central path's conditions, as one symmetric matrix of bounded entries, factored.

With s and y of the path as functions of the gap t = s - y (``smoothing``), D = ds/dt and B = (I - D)^1/2, what the
conditions P x + q + A'y = 0 and A x + s = b change by, in x and in v where dy = B v, is

    [ P    A'B ] [dx]
    [ BA   -D  ] [v ].

Its entries stay below the program's own at any mu, where the Newton system of an interior point (``kkt``) has
entries of 1 / mu. And a node needs no curvature of its own: a little regularisation makes the matrix quasidefinite, all
rows are eliminated at once, with the bounds of the norms, and what is left is block tridiagonal in the nodes. Iterative
refinement takes the regularisation away again.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.cones.product import ConeVector
from jaxscp.conic import kkt
from jaxscp.conic.kkt import Primal
from jaxscp.conic.program import StagedProgram
from jaxscp.conic.smoothing import Pair, Spectrum, act
from jaxscp.core.trees import tree_axpy, tree_max
from jaxscp.core.types import Scalar
from jaxscp.linalg import block_tridiagonal
from jaxscp.linalg.batched import gram

Unknowns = tuple[Primal, ConeVector]

_REGULARISATION = (
    1e-8  # the root of the rounding: what it perturbs, and what rounding perturbs for it, are equal
)
_REFINED = 1e-14  # relative residual at which refinement ends
_TINY = 1e-300  # keeps the residual of a right-hand side of zeros finite


class System(eqx.Module):
    """The matrix at one point of the path, factored."""

    program: StagedProgram
    pair: Pair
    root: Spectrum
    """B."""
    weight: Spectrum
    """(D + regularisation)^-1."""
    bound: Float[Array, "cones"]
    """Inverse curvature of the bounds xi and zeta; zero for the cones of the user."""
    coupling: Float[Array, "cones tail"]
    """What a tail does to the bound of its norm."""
    factor: block_tridiagonal.BlockCholesky

    def times(self, u: Unknowns) -> Unknowns:
        """The matrix itself, without regularisation."""
        x, v = u
        hessian = kkt.times_hessian(self.program, x)
        first = tree_axpy(1.0, hessian, kkt.times_constraints_transpose(self.program, self.scaled(v)))
        row = self.scaled(kkt.times_constraints(self.program, x))
        return first, tree_axpy(-1.0, act(self.pair.of_slack, self.pair.unit, v), row)

    def scaled(self, v: ConeVector) -> ConeVector:
        """B v."""
        return act(self.root, self.pair.unit, v)

    def solve(self, right: Unknowns) -> tuple[Unknowns, Scalar]:
        """Solve, by refinement of the regularised solution as long as it helps; also says what is still lacking,
        relative to the right-hand side."""
        size = jnp.maximum(tree_max(right), _TINY)

        def going(state):
            _, _, lack, before = state
            return (lack > _REFINED) & (lack <= 0.5 * before)

        def refine(state):
            u, left, lack, _ = state
            u = tree_axpy(1.0, self._solve_regularised(left), u)
            left = tree_axpy(-1.0, self.times(u), right)
            return u, left, tree_max(left) / size, lack

        start = jax.tree.map(jnp.zeros_like, right)
        u, _, lack, _ = jax.lax.while_loop(
            going, refine, (start, right, tree_max(right) / size, jnp.full_like(size, 2.0))
        )
        return u, lack

    def _solve_regularised(self, right: Unknowns) -> Unknowns:
        rx, rv = right
        lifted = act(_product(self.root, self.weight), self.pair.unit, rv)
        gradient = tree_axpy(1.0, kkt.times_constraints_transpose(self.program, lifted), rx)
        bounds = _per_cone(self.program, gradient)
        shift = kkt.times_constraints_transpose(self.program, _tails(lifted, self.coupling * bounds[:, None]))
        z = block_tridiagonal.solve(self.factor, gradient.z + shift.z)
        x = Primal(z, jnp.zeros_like(rx.xi), jnp.zeros_like(rx.zeta))
        tails = kkt.times_constraints(self.program, x).second[:, 1:]
        bounds = self.bound * bounds + jnp.sum(self.coupling * tails, axis=1)
        _, xi, zeta = _groups(self.program, bounds)
        x = Primal(z, xi, zeta)
        row = self.scaled(kkt.times_constraints(self.program, x))
        return x, act(self.weight, self.pair.unit, tree_axpy(-1.0, rv, row))


def factorise(program: StagedProgram, pair: Pair) -> System:
    """Eliminate all rows, then the bounds of the norms, and factor what is left."""
    weight = jax.tree.map(lambda d: 1.0 / (d + _REGULARISATION), pair.of_slack)
    root = jax.tree.map(jnp.sqrt, pair.of_multiplier)
    theta = _product(pair.of_multiplier, weight)
    mean, half = 0.5 * (theta.plus + theta.minus), 0.5 * (theta.plus - theta.minus)
    user, xi, zeta = _groups(program, jnp.ones_like(mean))
    bounded = jnp.concatenate([*(jnp.zeros_like(v) for v in user), xi, zeta])
    bound = bounded / (mean + _REGULARISATION)
    coupling = (half * bound)[:, None] * pair.unit
    # of a tail alone, once its bound is eliminated: mean - half^2 / (mean + regularisation), without cancellation
    along = (theta.plus * theta.minus + _REGULARISATION * mean) / (mean + _REGULARISATION)
    factor = block_tridiagonal.factor(*_blocks(program, theta, along, pair.unit))
    return System(program, pair, root, weight, bound, coupling, factor)


def _blocks(program: StagedProgram, theta: Spectrum, along: Float[Array, "cones"], unit):
    """Diagonal blocks of the matrix that is left in the nodes' variables, and those right of them."""
    n = program.variables
    diagonal = program.hessian + _REGULARISATION * jnp.eye(n, dtype=along.dtype)
    diagonal += gram(program.rows.matrix, theta.orthant[..., None] * program.rows.matrix)
    tails = _symmetric(theta.across, along, unit)
    user, _, _ = _groups(program, _whole(theta, unit))
    for cone, block in zip(program.cones, user, strict=True):
        nodes, count, dimension, _ = cone.matrix.shape
        block = block[:, :dimension, :dimension].reshape(nodes, count, dimension, dimension)
        diagonal += jnp.einsum("kcin,kcij,kcjm->knm", cone.matrix, block, cone.matrix)
    _, trust, virtual = _groups(program, tails)
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


def _symmetric(across: Float[Array, "cones"], along: Float[Array, "cones"], unit: Float[Array, "cones tail"]):
    """across (I - uu') + along uu'."""
    eye = jnp.eye(unit.shape[1], dtype=unit.dtype)
    outer = unit[:, :, None] * unit[:, None, :]
    return across[:, None, None] * (eye - outer) + along[:, None, None] * outer


def _whole(theta: Spectrum, unit: Float[Array, "cones tail"]) -> Float[Array, "cones dimension dimension"]:
    """The matrices of the second-order cones' part of a spectrum."""
    mean, half = 0.5 * (theta.plus + theta.minus), 0.5 * (theta.plus - theta.minus)
    side = half[:, None, None] * unit[:, :, None]
    top = jnp.concatenate([mean[:, None, None], jnp.swapaxes(side, 1, 2)], axis=2)
    bottom = jnp.concatenate([side, _symmetric(theta.across, mean, unit)], axis=2)
    return jnp.concatenate([top, bottom], axis=1)


def _groups(program: StagedProgram, v: Array):
    """What belongs to each group of second-order cones: (the user's, trust region, virtual control)."""
    sizes = [cone.offset.shape[0] * cone.offset.shape[1] for cone in program.cones]
    sizes.append(0 if program.norm is None else program.nodes)
    *user, trust, virtual = jnp.split(v, np.cumsum(sizes))
    return user, trust, virtual


def _per_cone(program: StagedProgram, x: Primal) -> Float[Array, "cones"]:
    """Bounds in the order of the cones, zero for the user's."""
    users = sum(cone.offset.shape[0] * cone.offset.shape[1] for cone in program.cones)
    return jnp.concatenate([jnp.zeros((users,), x.z.dtype), x.xi, x.zeta])


def _tails(like: ConeVector, tail: Float[Array, "cones tail"]) -> ConeVector:
    """A vector of tails alone."""
    second = jnp.concatenate([jnp.zeros_like(tail[:, :1]), tail], axis=1)
    return ConeVector(jnp.zeros_like(like.zero), jnp.zeros_like(like.orthant), second)


def _product(a: Spectrum, b: Spectrum) -> Spectrum:
    return jax.tree.map(jnp.multiply, a, b)
