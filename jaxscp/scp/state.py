"""What the loop of ``newton`` carries from one subproblem to the next."""

import equinox as eqx
from jaxtyping import Array, Float

from jaxscp.conic.program import ConicMultipliers
from jaxscp.core.status import StatusCode
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.problem.multipliers import Multipliers
from jaxscp.scp.history import History
from jaxscp.transcription.lagrangian import Residual
from jaxscp.transcription.shooting import Linearisation


class NewtonState(eqx.Module):
    """State of the loop."""

    z: Float[Array, "nodes variables"]
    """The reference: the last accepted iterate."""
    linear: Linearisation
    """Its intervals."""
    curvature: Float[Array, "intervals inputs inputs"]
    """Second derivatives of the Lagrangian there: kept, because the step after a refused one asks for them again."""
    multipliers: Multipliers
    """Of the subproblem that led to it, of the flight's constraints."""
    prices: ConicMultipliers
    """Of its rows."""
    past: Residual
    """The last accepted points, newest first."""
    proximal: Scalar
    exact: Flag
    """Whether curvature is condensed by now."""
    scale: Float[Array, "variables"]
    """Typical sizes of a node's variables: the largest of the iterates so far, at least one."""
    cost: Scalar
    iterations: Count
    near: Flag
    """Whether the optimum is near enough for the interior point."""
    reached: Flag
    """Whether the point is the optimum itself, and the multipliers its own."""
    newton_steps: Count
    """Of the interior point."""
    status: StatusCode
    done: Flag
    history: History
