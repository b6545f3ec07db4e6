"""A landing scenario: a mission with the interface that a planner needs."""

import dataclasses
import os

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxscp.core import pytree_file
from jaxscp.core.errors import InvalidScenario
from jaxscp.core.types import Flag, Scalar
from jaxscp.landing.allocation import allocate
from jaxscp.landing.deck import deck_outside, goal_was_left
from jaxscp.landing.guess import initial_guess
from jaxscp.landing.mission import PARTS, Mission
from jaxscp.landing.passed import present_place, without_passed
from jaxscp.landing.places import Places, ends_route, fits, leg_of, places_on
from jaxscp.landing.problem import landing_problem
from jaxscp.landing.recovery import RECOVERY, starts_outside
from jaxscp.landing.units import Units, in_units, units_of
from jaxscp.landing.validation import check_types, nodes_of, valid, validate
from jaxscp.landing.warm_guess import warm_guess
from jaxscp.problem.form import Continuous, Form
from jaxscp.problem.node_values import node_times
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.time import FreeTime, limit_reached
from jaxscp.problem.trajectory import Trajectory


class LandingScenario(Mission):
    """All data of a landing as one pytree; every float is a leaf that a study may vary.

    Numbers are in SI units and float64. The first eight fields have no default; ``scenarios.through`` takes the paper's
    airframe, cone angle, weights and dilations.

    Args:
        airframe: ``Airframe``: mass in kg, inertia in kg m^2, rotors in N, hull radius in m.
        start: ``BodyState`` at time zero: position (3,) m, velocity (3,) m/s, attitude (4,), body rate (3,) rad/s.
        goal: ``BodyState`` on the deck. Position and attitude are the deck's at time zero; the velocity is relative to
            the deck. The landing cone stands on the goal's x-y plane.
        corridor: ``Corridor``: polytopes for the vehicle's centre, m.
        cone_angle: (), rad: angle of the landing cone's side above the deck, in (0, pi/2).
        weights: ``Weights`` of the cost: control per N s, time per s.
        dilation_min: (), s: least dt/dtau, and so the least flight time.
        dilation_max: (), s: greatest dt/dtau, and so the greatest flight time.
        obstacles: (points, 3), m, for pictures alone; default None.
        limits: ``FlightLimits``: speed m/s, tilt rad, body rate rad/s, thrust rate N/s; default None, no limits.
        keep_out: ``Ellipsoids`` that the centre stays out of, at rest; default None.
        gates: ``Ellipsoids`` to pass, in this order, at rest; default None.
        deck_velocity: (3,), m/s, world. Goal and landing cone move with it: at time t the goal is at ``goal.position +
            deck_velocity t``. The attitude stays: a deck does not turn. Default None, a deck at rest.
        start_fixed: ``Components`` of the start that are fixed; default None, all.
        goal_fixed: ``Components`` of the goal that are fixed; default None, all.
        recovery: (), m by which the start may lie outside of walls and zones; default 0.
        near_obstacles: ``Obstacles`` that the certificate keeps the hull from; default None, none are known.

    Time zero is the start of the flight. For a re-plan in flight it is now: ``after`` moves the goal there.

    Example:
        >>> import dataclasses, jaxscp
        >>> scenario = jaxscp.scenarios.platform_to_platform()
        >>> scenario.corridor.count
        5
        >>> slow = dataclasses.replace(scenario, limits=jaxscp.flight_limits(speed=3.0))
    """

    def save(self, file: str | os.PathLike) -> None:
        """Write all numbers of the scenario to an .npz, for ``LandingScenario.load``. No code is stored.

        Raises:
            OSError: if the file cannot be written.

        Example:
            >>> import jaxscp, pathlib, tempfile
            >>> file = pathlib.Path(tempfile.mkdtemp()) / "scenario.npz"
            >>> jaxscp.scenarios.platform_to_platform().save(file)
            >>> jaxscp.LandingScenario.load(file).corridor.count
            5
        """
        pytree_file.write(file, {"scenario": self})

    @staticmethod
    def load(file: str | os.PathLike) -> "LandingScenario":
        """The scenario that ``save`` wrote, or ``Solution.save(file, scenario)``, bitwise.

        Raises:
            ValueError: if the file is damaged, of a newer format, or holds no landing; the message names the field.
            OSError: if the file cannot be read.
        """
        found = pytree_file.read(file, "scenario", (LandingScenario, *PARTS))
        if not isinstance(found, LandingScenario):
            raise ValueError(
                f"{file}: holds no scenario of a landing; scenario.save(file) writes one, and so does "
                "solution.save(file, scenario)"
            )
        return found

    def after(self, seconds: Scalar | float) -> "LandingScenario":
        """The scenario as seen some seconds later: the goal is where the deck has moved to.

        Corridor, zones, gates and obstacles are at rest in the world and stay. So does the start: replace it by the
        measured state.

        Args:
            seconds: since this scenario's time zero; may be traced.

        Example:
            >>> import dataclasses, jax, jaxscp
            >>> jax.config.update("jax_enable_x64", True)
            >>> scenario = jaxscp.scenarios.platform_to_platform()
            >>> moving = dataclasses.replace(scenario, deck_velocity=[0.5, 0.0, 0.0])
            >>> moving.after(2.0).goal.position.tolist()
            [11.0, 0.0, 1.0]
        """
        if self.deck_velocity is None:
            return self
        here = self.goal.position + self.deck_velocity * seconds
        return dataclasses.replace(self, goal=dataclasses.replace(self.goal, position=here))

    def check(self, nodes: int) -> None:
        """Raise ``InvalidScenario`` if the scenario contradicts itself.

        Leaves may be ``jax.ShapeDtypeStruct``: then shapes and dtypes are checked, and no values.
        """
        if any(isinstance(leaf, jax.ShapeDtypeStruct) for leaf in jax.tree.leaves(self)):
            check_types(self, nodes)
        else:
            validate(self, nodes)

    def valid(self) -> Flag:
        """Whether the scenario is valid, as an array: for elements of a batch."""
        return valid(self)

    def solver_inputs(self) -> "LandingScenario":
        """The scenario without what no solver reads, so that it shares programs: pictures' obstacles, and a margin."""
        plain = self if self.obstacles is None else eqx.tree_at(lambda s: s.obstacles, self, None)
        if getattr(self.corridor, "margin", None) is None:  # its class is not checked yet
            return plain
        return eqx.tree_at(lambda s: s.corridor.margin, plain, None)

    def usual_nodes(self) -> int:
        """Nodes for the legs of its route, by its shape alone: polytopes and gates."""
        return nodes_of(self)

    def measured(self) -> "LandingScenario":
        """The same; its start may lie a little outside of walls, zones and limits."""
        return eqx.tree_at(lambda s: s.recovery, self, jnp.maximum(self.recovery, RECOVERY))

    def starts_outside(self) -> Flag:
        """Whether its start does."""
        return starts_outside(self.with_unit_directions())

    def without_passed(
        self, context: Places, interval: Int[Array, ""], time: Scalar
    ) -> tuple["LandingScenario", Places]:
        """The rest of the mission from an interval of a plan on, ``time`` s long, and the plan's places for it.

        All of it, where the plan's route ends elsewhere: other polytopes or gates are asked for than the plan knows.
        """
        gates = 0 if self.gates is None else self.gates.centres.shape[0]
        known = ends_route(context[-1], self.corridor, gates)
        place = jnp.where(known, present_place(self, context, interval), 0)
        rest = without_passed(self, place, time)
        return rest, jnp.maximum(context, place)  # pyright: ignore[reportReturnType]

    def in_solver_units(self, form: Form) -> tuple["LandingScenario", Units | None]:
        """The scenario in units taken from it, and the units.

        Args:
            form: statement that the method solves; the paper's weights are for the user's own units.
        """
        if form.carries_cost:
            return self, None
        units = units_of(self)
        return in_units(self, units), units

    def problem(
        self,
        nodes: int,
        form: Form = Continuous(),  # noqa: B008
        context: Places | None = None,
    ) -> tuple[OptimalControlProblem, Places]:
        """The optimal control problem, and the place of every interval: its polytope, and the gates behind it.

        Args:
            nodes: N.
            form: statement that the method solves; the default method's by default.
            context: places to use again, in a re-plan; others are returned if they do not fit the route.
        """
        route = jax.lax.stop_gradient(self).with_unit_directions().route()  # no differentiable function
        fresh = places_on(route, allocate(route, nodes))
        context = fresh if context is None else jnp.where(fits(context, fresh), context, fresh)
        return landing_problem(self, leg_of(context), form), context

    def hindrance(self, plan: Trajectory) -> str:
        """What hinders a plan that did not converge, as far as the scenario tells.

        A deck left the corridor, or the flight time is at ``dilation_min`` or ``dilation_max``.

        Example:
            >>> import dataclasses, jax, jaxscp
            >>> jax.config.update("jax_enable_x64", True)
            >>> scenario = jaxscp.scenarios.platform_to_platform()
            >>> moving = dataclasses.replace(scenario, deck_velocity=[0.25, 0.0, 0.0])
            >>> still = jaxscp.Trajectory.from_arrays([0.0, 5.0], [[0.0] * 13] * 2, [[0.0] * 4] * 2)
            >>> moving.hindrance(still)
            'at 5 s the deck is 0.25 m outside the last polytope, which it leaves at 4 s'
        """
        last = float(plan.time[-1])
        return deck_outside(self, last) or limit_reached(FreeTime(self.dilation_min, self.dilation_max), last)

    def replan_doubt(self, plan: Trajectory, elapsed: float) -> str:
        """Doubt about a goal that did not move with the deck since a plan began; see ``after``."""
        return goal_was_left(self, plan, elapsed)

    def guess(self, problem: OptimalControlProblem, context: Places) -> Trajectory:
        """A smooth trajectory through the corridor, without derivatives."""
        guess = initial_guess(jax.lax.stop_gradient(self), leg_of(context))
        return Trajectory(node_times(guess.dilation), guess.states, guess.controls, guess.dilation)

    def sized(self, stated: OptimalControlProblem, guess: Trajectory, form: Form) -> None:
        """None: the units of ``in_solver_units`` are good."""
        return

    def warm_guess(self, plan: Trajectory) -> Trajectory:
        """A plan of a similar scenario, moved to this one's start and goal.

        Raises:
            InvalidScenario: if the plan is not one of 13 states, or has another number of rotors.
        """
        sizes = (("state", 13, "states"), ("control", self.airframe.body.control_size, "rotors"))
        for name, size, words in sizes:
            if (found := getattr(plan, name).shape[-1]) != size:
                raise InvalidScenario(
                    f"solution.trajectory.{name}: has {found} columns, but the scenario has {size} {words}."
                )
        return warm_guess(jax.lax.stop_gradient(self), plan)
