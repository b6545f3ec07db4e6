"""The judge's own linearisation of every interval, by an eighth-order method that the solver does not use."""

import jax.numpy as jnp
from diffrax import ConstantStepSize, Dopri8, ForwardMode, ODETerm, SaveAt, diffeqsolve
from jaxtyping import Array, Float

from jaxscp.intervals import Grid, Linearisation, Outputs, linearise, path_outputs
from jaxscp.problem import OptimalControlProblem


def relinearise(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], grid: Grid
) -> Linearisation:
    """What ``intervals.linearise`` says, one step of the method for every stretch between two points."""
    return linearise(problem, z, grid, _outputs)


def _outputs(problem: OptimalControlProblem, w: Float[Array, "inputs"], given, grid: Grid) -> Outputs:
    n, m = problem.state_size, problem.dynamics.control_size + 1
    start, first, last = w[:n], w[n : n + m], w[n + m :]
    shares = jnp.linspace(0.0, 1.0, grid.points + 1, dtype=w.dtype)

    def rate(share, extended, ends):
        derivative, cost = problem.rate(extended[:n], ends[0] + share * (ends[1] - ends[0]))
        return jnp.append(derivative, cost) / (problem.nodes - 1)

    solution = diffeqsolve(
        ODETerm(rate),
        Dopri8(scan_kind="lax"),
        0.0,
        1.0,
        1.0 / grid.points,
        jnp.append(start, 0.0),
        args=(first, last),
        saveat=SaveAt(ts=shares),
        stepsize_controller=ConstantStepSize(),
        adjoint=ForwardMode(),
        max_steps=grid.points + 1,
        throw=False,
    )
    path = jnp.asarray(solution.ys)
    controls = first + shares[:, None] * (last - first)
    return path_outputs(problem, path[:, :n], controls, path[-1, n], given)
