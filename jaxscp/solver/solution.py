"""The solution of a problem. A planner from a file needs this module and its imports, and no solver."""

from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from jaxscp.core.status import StatusCode
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.trajectory import Trajectory
from jaxscp.scp.history import History
from jaxscp.verification.certificate import Certificate


class Solution(eqx.Module):
    """A planned trajectory with its checks: look at ``status`` first.

    Values are finite, but for the certificate of a trajectory that cannot be integrated.
    """

    status: StatusCode
    """``converged`` only if the iterations converged and the certificate passed."""
    trajectory: Trajectory
    cost: Scalar
    """Running and terminal cost of the problem."""
    final_time: Scalar
    """s"""
    iterations: Count
    """Subproblems solved."""
    interior_point_iterations: Count
    """Newton steps of the interior point, from the last subproblem's point to the optimum."""
    differentiable: Flag
    """Whether the solution is an optimum to rounding, so that it has derivatives; else requested ones are NaN."""
    multipliers: Multipliers | None
    """Of the dynamics, of the conditions at both ends and of the constraints; None for a method without them."""
    certificate: Certificate
    history: History
    z: Float[Array, "nodes variables"]
    """Node variables, in the units of the solver."""
    context: Any
    """Data that the scenario built its problem with; for a landing, the polytope of every interval."""
