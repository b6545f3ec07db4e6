"""The recursion as JAX. Its steps are those of ``native/recursion.h``, in the same order."""

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve

from jaxscp.linalg.riccati.system import Factor, KKTVector, LQProblem, apply

PENALTY = 1e7  # of the conditions at the ends, before refinement


def factor(chain: LQProblem) -> Factor:
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


def solve(factor: Factor, right: KKTVector, refinements: int) -> KKTVector:
    """Solve for one right-hand side."""

    def refine(_, x):
        rest = jax.tree.map(jnp.subtract, right, apply(factor.chain, x))
        return jax.tree.map(jnp.add, x, _solve_once(factor, rest))

    return jax.lax.fori_loop(0, 1 + refinements, refine, jax.tree.map(jnp.zeros_like, right))


def _solve_once(factor: Factor, right: KKTVector) -> KKTVector:
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
    return KKTVector(nodes, price, initial, final)
