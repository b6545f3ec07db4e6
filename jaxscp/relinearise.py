"""The judge's own linearisation of every interval, by an eighth-order method that the solver does not use."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.intervals import (
    Grid,
    Linearisation,
    Outputs,
    linearise,
    path_outputs,
)
from jaxscp.problem import OptimalControlProblem
from jaxscp.sweeps import controls_at


def relinearise(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], grid: Grid
) -> Linearisation:
    """What ``intervals.linearise`` says, one step of the method for every stretch between two points."""
    return linearise(problem, z, grid, _outputs)


def _outputs(problem: OptimalControlProblem, w: Float[Array, "inputs"], given, grid: Grid) -> Outputs:
    from diffrax import ConstantStepSize, Dopri8, ForwardMode, ODETerm, SaveAt, diffeqsolve  # slow to import

    n = problem.state_size
    shares = jnp.linspace(0.0, 1.0, grid.points + 1, dtype=w.dtype)

    def rate(share, extended, w):
        return problem.slope(extended[:n], controls_at(w, n, share))

    solution = diffeqsolve(
        ODETerm(rate),
        Dopri8(scan_kind="lax"),
        0.0,
        1.0,
        1.0 / grid.points,
        jnp.append(w[:n], 0.0),
        args=w,
        saveat=SaveAt(t0=True, steps=True),
        stepsize_controller=ConstantStepSize(),
        adjoint=ForwardMode(),
        max_steps=grid.points,
        throw=False,
    )
    path = jnp.asarray(solution.ys)
    return path_outputs(problem, path[:, :n], controls_at(w, n, shares), path[-1, n], given)
