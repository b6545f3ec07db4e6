"""Planned controls flown from the initial state to the end, by an adaptive eighth-order method at tight tolerance.

    accuracy.py   how accurately
    method.py     Dormand and Prince's table
    in_jax.py     by diffrax
    kernel.py     by a kernel for NVIDIA GPUs, which ``source.py`` writes from the tape of the dynamics

The method is not the solver's, nor is any of this code, but for what turns dynamics into kernels: what comes of that
is compared with the dynamics.
"""

from jaxtyping import Array, Float

from jaxscp.backends.libraries import dispatch
from jaxscp.dynamics.base import Dynamics
from jaxscp.problem.trajectory import Trajectory
from jaxscp.verification.integrator import in_cuda, in_jax


def states(dynamics: Dynamics, trajectory: Trajectory, samples: int) -> Float[Array, "intervals samples n"]:
    """States at equally many points of every interval, from its first to its last.

    Args:
        dynamics: of what flies.
        trajectory: of which the first state is taken, and controls and dilation, linear between the nodes.
        samples: points an interval, two at least.

    Returns:
        Infinite from the first interval on that cannot be integrated.

    Raises:
        ValueError: if there are fewer samples: an interval begins where the last sample of the one before is.
    """
    if samples < 2:
        raise ValueError(f"samples: {samples} of an interval, but its first and its last point are needed")
    start, control, dilation = trajectory.state[0], trajectory.control, trajectory.dilation

    def by_diffrax(start, control, dilation):
        return in_jax.states(dynamics, start, control, dilation, samples)

    by_kernel = in_cuda.flight(dynamics, start, control, samples)
    return dispatch(None, by_diffrax, start, control, dilation, cuda=by_kernel)
