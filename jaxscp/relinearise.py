"""The judge's own linearisation of every interval, by an eighth-order method that the solver does not use."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.discretise import interval_inputs
from jaxscp.intervals import Grid, Linearisation, given, intervals_of, outputs
from jaxscp.problem import OptimalControlProblem
from jaxscp.sweeps import Intervals, controls_at, in_jax


def relinearise(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], grid: Grid
) -> Linearisation:
    """What ``intervals.linearise`` says, one step of the method for every stretch between two points."""
    found = in_jax.linear(
        intervals_of(problem, grid), interval_inputs(problem, z), given(problem, grid), _fly
    )
    return Linearisation(*(outputs(problem, part) for part in found))


def _fly(intervals: Intervals, w: Float[Array, "inputs"]) -> in_jax.Path:
    from diffrax import ConstantStepSize, Dopri8, ForwardMode, ODETerm, SaveAt, diffeqsolve  # slow to import

    n, stretches = intervals.states, intervals.points - 1

    def rate(share, extended, w):
        return intervals.rate(extended[:n], controls_at(w, n, share))

    solution = diffeqsolve(
        ODETerm(rate),
        Dopri8(scan_kind="lax"),
        0.0,
        1.0,
        1.0 / stretches,
        jnp.append(w[:n], 0.0),
        args=w,
        saveat=SaveAt(steps=True),
        stepsize_controller=ConstantStepSize(),
        adjoint=ForwardMode(),
        max_steps=stretches,
        throw=False,
    )
    return jnp.asarray(solution.ys)
