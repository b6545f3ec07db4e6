"""A problem and a guess as a scenario: what a solver is asked."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxscp.core.errors import InvalidProblem
from jaxscp.core.types import Flag
from jaxscp.problem.canonical import as_array, canonical
from jaxscp.problem.check import check_shapes, check_values, rules
from jaxscp.problem.form import Form
from jaxscp.problem.lowering import dilation_limits
from jaxscp.problem.node_values import node_times
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.solver.sized import Sized
from jaxscp.solver.solution import Solution


class Request(eqx.Module):
    """A problem with programs for functions, and a guess on its nodes."""

    asked: OptimalControlProblem
    start: Trajectory

    def check(self, nodes: int) -> None:
        """Raise ``InvalidProblem`` if a value contradicts another; shapes alone count for ``ShapeDtypeStruct``."""
        check_shapes(self.asked, self.start)
        if not any(isinstance(leaf, jax.ShapeDtypeStruct) for leaf in jax.tree.leaves(self)):
            check_values(self.asked, self.start)

    def valid(self) -> Flag:
        """Whether all rules hold, as an array: for elements of a batch."""
        return jnp.all(jnp.stack([jnp.asarray(rule.holds) for rule in rules(self.asked, self.start, jnp)]))

    def solver_inputs(self) -> "Request":
        """All of it."""
        return self

    def usual_nodes(self) -> int:
        """Those of the problem."""
        return self.asked.time.nodes

    def measured(self) -> "Request":
        """All of it: the problem says where it starts."""
        return self

    def starts_outside(self) -> Flag:
        """False: the problem's own constraints hold from the start."""
        return jnp.zeros((), bool)

    def without_passed(self, context: Any, interval: Any, time: Any) -> tuple["Request", Any]:
        """All of it: the problem says where it starts."""
        return self, context

    def in_solver_units(self, form: Form) -> tuple["Request", None]:
        """As it is: a problem states its own scale."""
        return self, None

    def problem(self, nodes: int, form: Form, context: Any = None) -> tuple[OptimalControlProblem, None]:
        """The problem, which needs no context."""
        return self.asked, None

    def sized(self, stated: OptimalControlProblem, guess: Trajectory, form: Form) -> Sized:
        """The problem, in sizes measured at the guess."""
        return Sized.on(stated, guess, form)

    def guess(self, problem: OptimalControlProblem, context: Any) -> Trajectory:
        """The guess, with a time that the problem allows."""
        return _in_time(self.asked, self.start)

    def hull(self, context: Any) -> None:
        """None: constraints and checks of the problem state all that is known."""
        return

    def warm_guess(self, plan: Trajectory) -> Trajectory:
        """The plan, with a time that the problem allows."""
        return _in_time(self.asked, plan)


def _in_time(problem: OptimalControlProblem, guess: Trajectory) -> Trajectory:
    """A guess with its dilation within the limits: one for a longer time costs less than all that is allowed.

    No step from there would lower the merit.
    """
    dilation = jnp.clip(guess.dilation, *dilation_limits(problem))
    time = jnp.where(jnp.any(dilation != guess.dilation), node_times(dilation), guess.time)
    return eqx.tree_at(lambda g: (g.time, g.dilation), guess, (time, dilation))


def request(problem: OptimalControlProblem, guess: Any) -> Request:
    """The request for a problem, from a trajectory or a solution of any number of nodes.

    Raises:
        InvalidProblem: if a function or a shape is wrong; the message names the field.
    """
    if isinstance(problem, tuple | list):
        raise InvalidProblem(
            f"problem: {len(problem)} problems were given. Several phases are not joined: state one problem in which "
            "each phase has a duration of its own as a static state, see docs/problems.md; or solve them one by one."
        )
    if not isinstance(problem, OptimalControlProblem):
        raise InvalidProblem(f"problem: expected an OptimalControlProblem, got a {type(problem).__name__}.")
    asked = canonical(problem)
    guess = guess.trajectory if isinstance(guess, Solution) else guess
    if not isinstance(guess, Trajectory):
        raise InvalidProblem(
            f"guess: expected a Trajectory or a Solution, got a {type(guess).__name__}. straight_line(problem, "
            "final_time) makes one; Trajectory.from_arrays(times, states, controls) another."
        )
    fields = {
        name: as_array(getattr(guess, name), f"guess.{name}").astype(float)
        for name in ("time", "state", "control", "dilation")
    }
    start = Trajectory(fields["time"], fields["state"], fields["control"], fields["dilation"])
    if any(v.ndim != d for v, d in zip(fields.values(), (1, 2, 2, 1), strict=True)):
        shapes = ", ".join(f"{name} {v.shape}" for name, v in fields.items())
        raise InvalidProblem(
            f"guess: expected axes (nodes,), (nodes, states), (nodes, controls), (nodes,); got {shapes}."
        )
    return Request(asked, start.resampled(asked.time.nodes))
