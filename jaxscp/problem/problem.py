"""The general optimal control problem (equation 8).

    minimise    integral of running(x, u, t) dt + terminal(x(t_f), t_f)
    subject to  dx/dt = dynamics(x, u, t),  constraints along the trajectory,  conditions at both ends

``scaled_time`` has the form that is solved.
"""

from collections.abc import Iterator
from typing import Any

import equinox as eqx

from jaxscp.core.trees import named_leaves
from jaxscp.dynamics.base import Dynamics
from jaxscp.problem.boundary import Boundary
from jaxscp.problem.constraint import Constraint
from jaxscp.problem.cost import Cost
from jaxscp.problem.scale import Scale
from jaxscp.problem.time import Time


class OptimalControlProblem(eqx.Module):
    """Dynamics, cost, constraints, boundary and time; every number in it is a leaf that a study may vary.

    Args:
        dynamics: ``Dynamics.of(function, states, controls)``, or a subclass of ``Dynamics``.
        cost: running and terminal.
        boundary: conditions at both ends.
        time: nodes, and free or fixed final time.
        constraints: along the trajectory.
        scale: typical sizes of all quantities; None takes them from guess, limits and dynamics.
        checks: constraints that the certificate alone judges: the solver does not know them.
        zero_order_hold: numbers of the controls that are constant over each interval, with their value at its first
            node; the others are linear in scaled time between nodes.

    Example:
        >>> import jaxscp
        >>> fastest = jaxscp.OptimalControlProblem(
        ...     dynamics=jaxscp.DoubleIntegrator(1),
        ...     cost=jaxscp.Cost(terminal=lambda x, t, p: t),
        ...     constraints=(jaxscp.bounds(control=(-2.0, 2.0)),),
        ...     boundary=jaxscp.Boundary(jaxscp.fixed_state([0.0, 0.0]), jaxscp.fixed_state([1.0, 0.0])),
        ...     time=jaxscp.Time(nodes=20, final=jaxscp.FreeTime(0.1, 10.0)),
        ... )
        >>> solution = jaxscp.solve(fastest, jaxscp.straight_line(fastest, final_time=2.0))
        >>> print(f"{solution.final_time:.3f}")
        1.414
    """

    dynamics: Dynamics
    cost: Cost
    boundary: Boundary
    time: Time
    constraints: tuple[Constraint, ...] = ()
    scale: Scale | None = None
    checks: tuple[Constraint, ...] = ()
    zero_order_hold: tuple[int, ...] = eqx.field(default=(), static=True)

    def named_constraints(self) -> Iterator[tuple[str, Constraint]]:
        """Constraints and checks with the names of their fields: ``constraints[0]``, say."""
        for field in ("constraints", "checks"):
            for number, constraint in enumerate(getattr(self, field)):
                yield f"{field}[{number}]", constraint

    def arrays(self) -> dict[str, Any]:
        """All numbers by their names; a solver from a file takes them in place of the problem."""
        return dict(named_leaves(self))
