"""States of a trajectory's controls, integrated from its first state."""

from jaxtyping import Array, Float

from jaxscp.backends.libraries import dispatch
from jaxscp.dynamics.base import Dynamics
from jaxscp.problem.trajectory import Trajectory
from jaxscp.verification.integrator import in_cuda, in_jax


def integrate(
    dynamics: Dynamics, trajectory: Trajectory, samples: int
) -> Float[Array, "intervals samples n"]:
    """States at equally spaced points of every interval, from its first to its last.

    Args:
        dynamics: to integrate.
        trajectory: gives the first state, the controls, and the dilation, linear between the nodes.
        samples: points an interval, two at least.

    Returns:
        States; infinite from the first interval on that cannot be integrated.

    Raises:
        ValueError: if there are fewer samples: an interval starts at the last sample of the interval before.
    """
    if samples < 2:
        raise ValueError(f"samples: {samples} of an interval, but its first and its last point are needed")
    start, control, dilation = trajectory.state[0], trajectory.control, trajectory.dilation

    def by_diffrax(start, control, dilation):
        ends = trajectory.controls_of_intervals(control)
        return in_jax.states(dynamics, start, ends, dilation, samples)

    linear = not trajectory.zero_order_hold
    by_kernel = in_cuda.kernel_for(dynamics, start, control, samples) if linear else None
    return dispatch(None, by_diffrax, start, control, dilation, cuda=by_kernel)
