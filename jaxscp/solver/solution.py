"""What a planner returns. It and its parts are apart from what makes them: a planner from a file needs no more."""

import equinox as eqx
from jaxtyping import Array, Float, Int

from jaxscp.core.status import StatusCode
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.trajectory import Trajectory
from jaxscp.scp.history import History
from jaxscp.verification.certificate import Certificate


class Solution(eqx.Module):
    """A planned flight and what is known about it: look at ``status`` first. Never NaN, and finite but for the
    certificate of a flight that cannot be integrated."""

    status: StatusCode
    """``converged`` only where the iterations converged and the certificate agrees."""
    trajectory: Trajectory
    cost: Scalar
    """w_u integral |u| dt + w_t t_f."""
    final_time: Scalar
    """s"""
    iterations: Count
    """Subproblems solved."""
    newton_steps: Count
    """Steps of the interior point that went from the last subproblem's point to the optimum."""
    differentiable: Flag
    """Whether the plan is an optimum to rounding, so that it has derivatives; else those asked for are NaN."""
    multipliers: Multipliers | None
    """Prices of the flow, of the conditions at both ends and of the constraints; None where the method has none."""
    certificate: Certificate
    history: History
    z: Float[Array, "nodes variables"]
    """Node variables: the warm start of a re-plan."""
    allocation: Int[Array, "intervals"]
    """Polytope of every interval."""
