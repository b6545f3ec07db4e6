"""Riccati recursion in JAX, in the steps of ``native/recursion.h``."""

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve

from jaxscp.linalg.riccati.system import Factor, KKTVector, LQProblem, apply

PENALTY = 1e7  # weight of the end conditions, before refinement


def factor(problem: LQProblem) -> Factor:
    """Factor of the system's matrix, from the last node to the first."""
    states, stage = problem.flow.shape[1], problem.last.shape[0]
    controls = problem.flow.shape[2] - stage
    select_controls = jnp.eye(controls, stage + controls, stage, dtype=problem.flow.dtype)

    def backward(value, interval):
        hessian, flow = interval
        transition = jnp.concatenate([flow, select_controls])  # X_{i+1} = transition w_i
        stage_hessian = hessian + transition.T @ value @ transition
        lower = jnp.linalg.cholesky(stage_hessian[stage:, stage:])
        gain = cho_solve((lower, True), stage_hessian[stage:, :stage])
        before = stage_hessian[:stage, :stage] - stage_hessian[:stage, stage:] @ gain
        return 0.5 * (before + before.T), (value, lower, gain)

    last = problem.last.at[:states, :states].add(PENALTY * problem.final.T @ problem.final)
    first, factors = jax.lax.scan(backward, last, (problem.hessian, problem.flow), reverse=True)
    first = first.at[:states, :states].add(PENALTY * problem.initial.T @ problem.initial)
    return Factor(problem, *factors, jnp.linalg.cholesky(first))


def solve(factor: Factor, right: KKTVector, refinements: int) -> KKTVector:
    """Solution for one right-hand side, by so many steps of iterative refinement."""

    def refine(_, x):
        residual = jax.tree.map(jnp.subtract, right, apply(factor.problem, x))
        return jax.tree.map(jnp.add, x, _solve_once(factor, residual))

    return jax.lax.fori_loop(0, 1 + refinements, refine, jax.tree.map(jnp.zeros_like, right))


def _solve_once(factor: Factor, right: KKTVector) -> KKTVector:
    """Solution of the system whose end conditions are penalties, without refinement."""
    problem = factor.problem
    states, stage = problem.flow.shape[1], problem.last.shape[0]

    def transition_transposed(flow, v):
        return (flow.T @ v[:states]).at[stage:].add(v[states:])

    def backward(gradient, interval):
        value, lower, gain, flow, flow_rhs, node_rhs = interval
        # the flow's equation A w - x = flow_rhs gives x = A w - flow_rhs
        at_next = gradient - value[:, :states] @ flow_rhs
        linear = transition_transposed(flow, at_next).at[:stage].add(-node_rhs)
        feedforward = cho_solve((lower, True), linear[stage:])
        return linear[:stage] - gain.T @ linear[stage:], (gradient, feedforward)

    last = (-right.nodes[-1]).at[:states].add(-PENALTY * problem.final.T @ right.final)
    intervals = (factor.value, factor.lower, factor.gain, problem.flow, right.flow, right.nodes[:-1])
    gradient, (gradients, feedforward) = jax.lax.scan(backward, last, intervals, reverse=True)
    gradient = gradient.at[:states].add(-PENALTY * problem.initial.T @ right.initial)
    start = -cho_solve((factor.first, True), gradient)

    def forward(node, interval):
        value, gain, flow, flow_rhs, gradient, feedforward = interval
        control = -gain @ node - feedforward
        state = flow @ jnp.concatenate([node, control]) - flow_rhs
        after = jnp.concatenate([state, control])
        return after, (after, (value @ after + gradient)[:states])

    intervals = (factor.value, factor.gain, problem.flow, right.flow, gradients, feedforward)
    _, (later, multipliers) = jax.lax.scan(forward, start, intervals)
    nodes = jnp.concatenate([start[None], later])
    initial = PENALTY * (problem.initial @ start[:states] - right.initial)
    final = PENALTY * (problem.final @ nodes[-1, :states] - right.final)
    return KKTVector(nodes, multipliers, initial, final)
