"""The Newton system of an optimal control problem, whose curvature need not be convex, by a Riccati recursion.

    minimise    sum_i 1/2 w_i' H_i w_i + 1/2 X_N' Q X_N + sum_k r_k' X_k         w_i = (X_i, U_{i+1})
    subject to  x_{i+1} = A_i w_i + d_i,    B x_0 = b,    E x_N = e

with X = (x, U) the variables of a node: state, and controls with their dilation. Backwards along the chain, the
controls at an interval's end are minimised over, which needs that the problem is convex in the directions that its
dynamics leave free: the second-order condition of a strict minimum, and no more than that. (A factorisation by nodes,
as in ``conic.kkt``, needs every block convex.) The conditions at both ends enter as penalties, and refinement against
the system as it stands makes them exact.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Float

from jaxscp.types import Flag, Scalar

PENALTY = 1e7  # of the conditions at the ends, before refinement
REFINEMENTS = 3


class Chain(eqx.Module):
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

    def shifted(self, shift: Scalar) -> "Chain":
        """With that much more curvature in every variable."""
        more = shift * jnp.eye(self.hessian.shape[-1], dtype=self.hessian.dtype)
        last = shift * jnp.eye(self.last.shape[-1], dtype=self.last.dtype)
        return eqx.tree_at(lambda c: (c.hessian, c.last), self, (self.hessian + more, self.last + last))


class Side(eqx.Module):
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

    chain: Chain
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


def apply(chain: Chain, x: Side) -> Side:
    """The system's matrix times a vector."""
    states = chain.flow.shape[1]
    w = _inputs(chain, x.nodes)
    pulled = jnp.einsum("iwv,iv->iw", chain.hessian, w) + jnp.einsum("isw,is->iw", chain.flow, x.flow)
    nodes = _scatter(chain, pulled).at[1:, :states].add(-x.flow)
    nodes = nodes.at[-1].add(chain.last @ x.nodes[-1])
    nodes = nodes.at[0, :states].add(chain.initial.T @ x.initial)
    nodes = nodes.at[-1, :states].add(chain.final.T @ x.final)
    flow = jnp.einsum("isw,iw->is", chain.flow, w) - x.nodes[1:, :states]
    return Side(nodes, flow, chain.initial @ x.nodes[0, :states], chain.final @ x.nodes[-1, :states])


def factor(chain: Chain) -> Factor:
    """Eliminate the chain from its end."""
    states, stage = chain.flow.shape[1], chain.last.shape[0]
    controls = chain.flow.shape[2] - stage
    keep = jnp.eye(controls, stage + controls, stage, dtype=chain.flow.dtype)

    def backward(value, interval):
        hessian, flow = interval
        onward = jnp.concatenate([flow, keep])  # X_{i+1} = onward w_i
        whole = hessian + onward.T @ value @ onward
        lower = jnp.linalg.cholesky(whole[stage:, stage:])
        gain = cho_solve((lower, True), whole[stage:, :stage])
        before = whole[:stage, :stage] - whole[:stage, stage:] @ gain
        return 0.5 * (before + before.T), (value, lower, gain)

    last = chain.last.at[:states, :states].add(PENALTY * chain.final.T @ chain.final)
    first, kept = jax.lax.scan(backward, last, (chain.hessian, chain.flow), reverse=True)
    first = first.at[:states, :states].add(PENALTY * chain.initial.T @ chain.initial)
    return Factor(chain, *kept, jnp.linalg.cholesky(first))


def solve(factor: Factor, right: Side) -> Side:
    """Solve for one right-hand side."""

    def refine(_, x):
        rest = jax.tree.map(jnp.subtract, right, apply(factor.chain, x))
        return jax.tree.map(jnp.add, x, solve_once(factor, rest))

    return jax.lax.fori_loop(0, 1 + REFINEMENTS, refine, jax.tree.map(jnp.zeros_like, right))


def solve_once(factor: Factor, right: Side) -> Side:
    """Solve but for the penalties of the ends and for rounding."""
    chain = factor.chain
    states, stage = chain.flow.shape[1], chain.last.shape[0]

    def onward_transposed(flow, v):
        return (flow.T @ v[:states]).at[stage:].add(v[states:])

    def backward(slope, interval):
        value, lower, gain, flow, lack, pull = interval
        # the flow's equation reads A w - x = lack, so that x = A w - lack
        moved = slope - value[:, :states] @ lack
        linear = onward_transposed(flow, moved).at[:stage].add(-pull)
        held = cho_solve((lower, True), linear[stage:])
        return linear[:stage] - gain.T @ linear[stage:], (slope, held)

    last = (-right.nodes[-1]).at[:states].add(-PENALTY * chain.final.T @ right.final)
    kept = (factor.value, factor.lower, factor.gain, chain.flow, right.flow, right.nodes[:-1])
    slope, (slopes, held) = jax.lax.scan(backward, last, kept, reverse=True)
    slope = slope.at[:states].add(-PENALTY * chain.initial.T @ right.initial)
    start = -cho_solve((factor.first, True), slope)

    def forward(node, interval):
        value, gain, flow, lack, slope, held = interval
        control = -gain @ node - held
        state = flow @ jnp.concatenate([node, control]) - lack
        after = jnp.concatenate([state, control])
        return after, (after, (value @ after + slope)[:states])

    kept = (factor.value, factor.gain, chain.flow, right.flow, slopes, held)
    _, (rest, price) = jax.lax.scan(forward, start, kept)
    nodes = jnp.concatenate([start[None], rest])
    initial = PENALTY * (chain.initial @ start[:states] - right.initial)
    final = PENALTY * (chain.final @ nodes[-1, :states] - right.final)
    return Side(nodes, price, initial, final)


def _inputs(chain: Chain, nodes: Float[Array, "nodes variables"]) -> Float[Array, "intervals inputs"]:
    return jnp.concatenate([nodes[:-1], nodes[1:, chain.flow.shape[1] :]], axis=1)


def _scatter(chain: Chain, w: Float[Array, "intervals inputs"]) -> Float[Array, "nodes variables"]:
    """The adjoint of ``_inputs``."""
    states, stage = chain.flow.shape[1], chain.last.shape[0]
    nodes = jnp.zeros((w.shape[0] + 1, stage), w.dtype).at[:-1].set(w[:, :stage])
    return nodes.at[1:, states:].add(w[:, stage:])
