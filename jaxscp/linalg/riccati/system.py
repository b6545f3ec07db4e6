"""Newton system of an optimal control problem, whose Hessian need not be positive definite.

    minimise    sum_i 1/2 w_i' H_i w_i + 1/2 X_N' Q X_N + sum_k r_k' X_k         w_i = (X_i, U_{i+1})
    subject to  x_{i+1} = A_i w_i + d_i,    B x_0 = b,    E x_N = e

with X = (x, U) the variables of a node: state, and controls with their dilation.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Flag, Scalar


class LQProblem(eqx.Module):
    """Matrix of the system."""

    hessian: Float[Array, "intervals inputs inputs"]
    """H."""
    last: Float[Array, "variables variables"]
    """Q: Hessian of the last node."""
    flow: Float[Array, "intervals states inputs"]
    """A."""
    initial: Float[Array, "initial states"]
    """B."""
    final: Float[Array, "final states"]
    """E."""

    def shifted(self, shift: Scalar) -> "LQProblem":
        """The problem with shift * I added to H and Q."""
        of_intervals = shift * jnp.eye(self.hessian.shape[-1], dtype=self.hessian.dtype)
        of_last = shift * jnp.eye(self.last.shape[-1], dtype=self.last.dtype)
        both = (self.hessian + of_intervals, self.last + of_last)
        return eqx.tree_at(lambda c: (c.hessian, c.last), self, both)


class Shifts(NamedTuple):
    """Multiples of the identity that are added to the Hessian, one after another, until the matrix is definite."""

    growth: float
    """From one shift to the next."""
    most: float
    """After a shift as large as this, there is no other."""


class KKTVector(eqx.Module):
    """Right-hand side; or solution, of the same shape."""

    nodes: Float[Array, "nodes variables"]
    """-r; solution: the step."""
    flow: Float[Array, "intervals states"]
    """-d; solution: multipliers of the flow."""
    initial: Float[Array, "initial"]
    """b; solution: multipliers of the conditions at the start."""
    final: Float[Array, "final"]
    """e; solution: multipliers of the conditions at the end."""


class Factor(eqx.Module):
    """Factor of the system's matrix."""

    problem: LQProblem
    value: Float[Array, "intervals variables variables"]
    """P_{i+1}: Hessian of the cost to go from the end of an interval."""
    lower: Float[Array, "intervals controls controls"]
    """Cholesky factor of the Hessian in the controls at an interval's end."""
    gain: Float[Array, "intervals controls variables"]
    """K: those controls are -K X, with X the interval's first node."""
    first: Float[Array, "variables variables"]
    """Cholesky factor of the first node's Hessian."""

    @property
    def definite(self) -> Flag:
        """Whether the second-order condition holds; if not, the factor is meaningless."""
        return jnp.all(jnp.isfinite(self.first)) & jnp.all(jnp.isfinite(self.lower))


def no_factor(problem: LQProblem) -> Factor:
    """Factor of NaN, which is not definite."""
    count, stage = problem.flow.shape[0], problem.last.shape[0]
    controls = problem.flow.shape[2] - stage
    shapes = (count, stage, stage), (count, controls, controls), (count, controls, stage), (stage, stage)
    return Factor(problem, *(jnp.full(shape, jnp.nan, problem.flow.dtype) for shape in shapes))


def apply(problem: LQProblem, x: KKTVector) -> KKTVector:
    """Product of the system's matrix and a vector."""
    states = problem.flow.shape[1]
    w = _inputs(problem, x.nodes)
    of_inputs = jnp.einsum("iwv,iv->iw", problem.hessian, w) + jnp.einsum("isw,is->iw", problem.flow, x.flow)
    nodes = _scatter(problem, of_inputs).at[1:, :states].add(-x.flow)
    nodes = nodes.at[-1].add(problem.last @ x.nodes[-1])
    nodes = nodes.at[0, :states].add(problem.initial.T @ x.initial)
    nodes = nodes.at[-1, :states].add(problem.final.T @ x.final)
    flow = jnp.einsum("isw,iw->is", problem.flow, w) - x.nodes[1:, :states]
    return KKTVector(nodes, flow, problem.initial @ x.nodes[0, :states], problem.final @ x.nodes[-1, :states])


def _inputs(problem: LQProblem, nodes: Float[Array, "nodes variables"]) -> Float[Array, "intervals inputs"]:
    return jnp.concatenate([nodes[:-1], nodes[1:, problem.flow.shape[1] :]], axis=1)


def _scatter(problem: LQProblem, w: Float[Array, "intervals inputs"]) -> Float[Array, "nodes variables"]:
    """The adjoint of ``_inputs``."""
    states, stage = problem.flow.shape[1], problem.last.shape[0]
    nodes = jnp.zeros((w.shape[0] + 1, stage), w.dtype).at[:-1].set(w[:, :stage])
    return nodes.at[1:, states:].add(w[:, stage:])
