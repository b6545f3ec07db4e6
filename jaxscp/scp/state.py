"""Settings of ``NewtonSCP``, and the state that its loop carries."""

import equinox as eqx
import jax
from jaxtyping import Array, Float

from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.program import ConicMultipliers, ConicSolver
from jaxscp.core.status import StatusCode
from jaxscp.core.types import Count, Flag, Nodes, Scalar
from jaxscp.nlp.interior_point import NLPInteriorPoint
from jaxscp.problem.multipliers import Multipliers
from jaxscp.scp.history import History
from jaxscp.transcription.lagrangian import Residual
from jaxscp.transcription.shooting import Grid, Linearisation


class NewtonSettings(eqx.Module):
    """Settings of ``NewtonSCP``, which documents them."""

    tolerance: float = 1e-4
    tolerance_defect: float = 5e-3
    tolerance_gradient: float = 0.1
    max_iterations: int = eqx.field(default=60, static=True)
    initial_forcing: float = 1e-2
    proximal: float = 0.1
    virtual_weight: float = 1000.0
    merit_weight: float = 10.0
    correction_rounds: int = eqx.field(default=2, static=True)
    grid: Grid = Grid()
    interior: NLPInteriorPoint = NLPInteriorPoint()
    conic: ConicSolver = InteriorPoint(tolerance=1e-7)


class NewtonState(eqx.Module):
    """State of the loop."""

    z: Float[Array, "nodes variables"]
    """The reference: the last accepted iterate."""
    linear: Linearisation
    """Linearisation about the reference."""
    hessian: Float[Array, "intervals inputs inputs"]
    """Second derivatives of the Lagrangian at the reference; the step after a rejected one uses them again."""
    multipliers: Multipliers
    """Of the subproblem that led to the reference."""
    conic_multipliers: ConicMultipliers
    """The same, by the rows of that subproblem."""
    merit_history: Residual
    """Residuals of the last accepted points, newest first."""
    proximal: Scalar
    """Weight of the squared (scaled) step."""
    full_hessian: Flag
    """Whether the Hessian is convexified along the horizon, else block by block."""
    scale: Float[Array, "variables"]
    """Typical sizes of a node's variables: the largest of the iterates so far, at least one."""
    accepted_with_small_proximal: Flag
    """Whether the last step was accepted while the proximal weight was small: only then is a small step convergence."""
    cost: Scalar
    iterations: Count
    close_to_optimum: Flag
    """Whether the interior point may start."""
    is_optimum: Flag
    """Whether the reference is the optimum to rounding, with its multipliers."""
    interior_point_iterations: Count
    status: StatusCode
    done: Flag
    history: History
    dilation_least: Nodes
    """Bounds of each node's dilation that held for the optimum; zero where the problem's own did."""
    dilation_most: Nodes
    """Infinite where the problem's own did."""

    @property
    def residual(self) -> Residual:
        """Residual of the reference."""
        return jax.tree.map(lambda v: v[0], self.merit_history)
