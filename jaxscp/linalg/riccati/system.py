"""The Newton system of an optimal control problem, whose curvature need not be convex.

    minimise    sum_i 1/2 w_i' H_i w_i + 1/2 X_N' Q X_N + sum_k r_k' X_k         w_i = (X_i, U_{i+1})
    subject to  x_{i+1} = A_i w_i + d_i,    B x_0 = b,    E x_N = e

with X = (x, U) the variables of a node: state, and controls with their dilation.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Flag, Scalar


class LQProblem(eqx.Module):
    """The system's matrix."""

    hessian: Float[Array, "intervals inputs inputs"]
    """H."""
    last: Float[Array, "variables variables"]
    """Q: of the last node."""
    flow: Float[Array, "intervals states inputs"]
    """A."""
    initial: Float[Array, "initial states"]
    """B."""
    final: Float[Array, "final states"]
    """E."""

    def shifted(self, shift: Scalar) -> "LQProblem":
        """With that much more curvature in every variable."""
        more = shift * jnp.eye(self.hessian.shape[-1], dtype=self.hessian.dtype)
        last = shift * jnp.eye(self.last.shape[-1], dtype=self.last.dtype)
        return eqx.tree_at(lambda c: (c.hessian, c.last), self, (self.hessian + more, self.last + last))


class KKTVector(eqx.Module):
    """A right-hand side, or an unknown of its shape."""

    nodes: Float[Array, "nodes variables"]
    """Minus r; the step."""
    flow: Float[Array, "intervals states"]
    """Minus d; multipliers of the flow."""
    initial: Float[Array, "initial"]
    """b; multipliers of the conditions at the start."""
    final: Float[Array, "final"]
    """e; multipliers of the conditions at the end."""


class Factor(eqx.Module):
    """What the recursion leaves for any right-hand side."""

    chain: LQProblem
    value: Float[Array, "intervals variables variables"]
    """P_{i+1}: curvature of the cost to go from the end of an interval."""
    lower: Float[Array, "intervals controls controls"]
    """Cholesky factor of the curvature over the controls at an interval's end."""
    gain: Float[Array, "intervals controls variables"]
    """K: those controls follow the interval's first node as -K X."""
    first: Float[Array, "variables variables"]
    """Cholesky factor of the first node's curvature."""

    @property
    def definite(self) -> Flag:
        """Whether the second-order condition holds; else nothing here means anything."""
        return jnp.all(jnp.isfinite(self.first)) & jnp.all(jnp.isfinite(self.lower))


def no_factor(chain: LQProblem) -> Factor:
    """What is not definite, in the shape of what is."""
    count, stage = chain.flow.shape[0], chain.last.shape[0]
    controls = chain.flow.shape[2] - stage
    shapes = (count, stage, stage), (count, controls, controls), (count, controls, stage), (stage, stage)
    return Factor(chain, *(jnp.full(shape, jnp.nan, chain.flow.dtype) for shape in shapes))


def apply(chain: LQProblem, x: KKTVector) -> KKTVector:
    """The system's matrix times a vector."""
    states = chain.flow.shape[1]
    w = _inputs(chain, x.nodes)
    pulled = jnp.einsum("iwv,iv->iw", chain.hessian, w) + jnp.einsum("isw,is->iw", chain.flow, x.flow)
    nodes = _scatter(chain, pulled).at[1:, :states].add(-x.flow)
    nodes = nodes.at[-1].add(chain.last @ x.nodes[-1])
    nodes = nodes.at[0, :states].add(chain.initial.T @ x.initial)
    nodes = nodes.at[-1, :states].add(chain.final.T @ x.final)
    flow = jnp.einsum("isw,iw->is", chain.flow, w) - x.nodes[1:, :states]
    return KKTVector(nodes, flow, chain.initial @ x.nodes[0, :states], chain.final @ x.nodes[-1, :states])


def _inputs(chain: LQProblem, nodes: Float[Array, "nodes variables"]) -> Float[Array, "intervals inputs"]:
    return jnp.concatenate([nodes[:-1], nodes[1:, chain.flow.shape[1] :]], axis=1)


def _scatter(chain: LQProblem, w: Float[Array, "intervals inputs"]) -> Float[Array, "nodes variables"]:
    """The adjoint of ``_inputs``."""
    states, stage = chain.flow.shape[1], chain.last.shape[0]
    nodes = jnp.zeros((w.shape[0] + 1, stage), w.dtype).at[:-1].set(w[:, :stage])
    return nodes.at[1:, states:].add(w[:, stage:])
