"""Planners compiled before their first call: for one shape of scenario, in this process or from a file.

A planner is three programs (``planner``), each of which takes what the one before returns. Here they are functions of
leaves, so that neither a call nor a file has to know the pytrees between them.
"""

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax
from jax.core import Tracer

from jaxscp.aot.pytree_spec import Description, difference, spec_of
from jaxscp.backends.xla import options
from jaxscp.landing.scenario import LandingScenario
from jaxscp.landing.validation import check_types, named_leaves, validate

Leaves = Sequence[Any]


class Program(NamedTuple):
    """One of a planner's programs, not compiled yet."""

    function: Any
    """Jitted; from leaves to a list of leaves."""
    shapes: Leaves
    """Of the leaves it takes: ``jax.ShapeDtypeStruct``."""


class Plan(NamedTuple):
    """All that is to be compiled, or stored."""

    nodes: int
    lanes: int | None
    scenario: Description
    """One scenario, obstacles left out."""
    solution: Any
    """A ``Solution`` of ``jax.ShapeDtypeStruct``, with a leading axis for the lanes."""
    setup: Program
    solve: Program
    conclude: Program

    @property
    def programs(self) -> dict[str, Program]:
        """By their names, in the order in which they are called."""
        return {"setup": self.setup, "solve": self.solve, "conclude": self.conclude}


def side_by_side(programs: dict[str, Program]) -> dict[str, jax.stages.Compiled]:
    """The programs compiled for this machine; they take and return leaves."""
    with ThreadPoolExecutor() as threads:
        begun = {}
        # the largest first: to lower one is Python's, and goes on while others are compiled
        for name in sorted(programs, key=lambda name: name != "solve"):
            lowered = programs[name].function.lower(*programs[name].shapes)
            begun[name] = threads.submit(lowered.compile, compiler_options=options())
        return {name: begun[name].result() for name in programs}


@dataclasses.dataclass(frozen=True)
class CompiledPlanner:
    """A planner for scenarios of one shape, compiled before its first call, which traces nothing.

    ``Planner.compile`` and ``jaxscp.load`` make these. The answers are bitwise the planner's own. Derivatives, ``vmap``
    and re-plans are the planner's alone.
    """

    nodes: int
    lanes: int | None
    """Scenarios a call; None for one without a leading axis."""
    scenario: Description = dataclasses.field(repr=False)
    solution: Any = dataclasses.field(repr=False)
    """Tree of a ``Solution``."""
    setup: Callable[..., Leaves] = dataclasses.field(repr=False)
    solve: Callable[..., Leaves] = dataclasses.field(repr=False)
    conclude: Callable[..., Leaves] = dataclasses.field(repr=False)

    def __call__(self, scenario: LandingScenario) -> Any:
        """The ``Solution`` of a scenario, or of ``lanes`` of them, stacked.

        Raises:
            InvalidScenario: if the scenario contradicts itself. In a batch, the lane's status is ``invalid_input``.
            TypeError: if the scenario's parts, shapes or dtypes are not those that were compiled for; the message names
                the field. The number of obstacles is free.
        """
        self._check(scenario)
        return self.run(scenario)

    def run(self, scenario: LandingScenario) -> Any:
        """The same for what has been checked."""
        leaves = jax.tree.leaves(without_obstacles(scenario))
        return self.go_on(self.setup(*leaves))

    def go_on(self, begun: Any) -> Any:
        """The rest, with what ``setup`` returns, or what is like it."""
        leaves = self.conclude(*self.solve(*jax.tree.leaves(begun)))
        return jax.tree.unflatten(self.solution, leaves)

    def _check(self, scenario: LandingScenario) -> None:
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scenario)):
            raise TypeError(
                "a compiled planner takes arrays; inside jit, vmap and grad, call the Planner itself"
            )
        if self.lanes is None:
            validate(scenario, self.nodes)
            one = scenario
        else:
            one = _one_lane(scenario, self.lanes)
            check_types(one, self.nodes)
        differs = difference(self.scenario, spec_of(without_obstacles(one)))
        if differs:
            raise TypeError(f"the planner was compiled for scenarios of another shape: {differs}")


def plan_ahead(
    parts: Sequence[Callable[..., Any]], scenario: LandingScenario, nodes: int, lanes: int | None
) -> Plan:
    """Trace the programs of a planner for scenarios like this one.

    Args:
        parts: the first takes a scenario, each of the others what the one before returns, and the last returns a
            ``Solution``.
        scenario: one; only its shapes and dtypes matter.
        nodes: N of the planner.
        lanes: how many scenarios at once; None for one without a leading axis.
    """
    check_types(scenario, nodes)
    bare = without_obstacles(scenario)
    axis = () if lanes is None else (lanes,)
    shapes: Any = (jax.tree.map(lambda v: jax.ShapeDtypeStruct(axis + v.shape, v.dtype), bare),)
    programs = []
    for part in parts:
        program, shapes = _program(part if lanes is None else jax.vmap(part), shapes)
        programs.append(program)
    return Plan(nodes, lanes, spec_of(bare), shapes, *programs)


def compiled(plan: Plan) -> CompiledPlanner:
    """Compile the programs, for this machine."""
    return with_programs(plan, side_by_side(plan.programs))


def with_programs(plan: Plan, programs: dict[str, Callable[..., Leaves]]) -> CompiledPlanner:
    """The planner whose programs these are."""
    tree = jax.tree.structure(plan.solution)
    return CompiledPlanner(plan.nodes, plan.lanes, plan.scenario, tree, **programs)


def without_obstacles(scenario: LandingScenario) -> LandingScenario:
    """The scenario without what no solver reads, so that it is no part of what is compiled for."""
    if scenario.obstacles is None:
        return scenario
    return eqx.tree_at(lambda s: s.obstacles, scenario, None)  # whatever its leaves are: shapes, say


def _program(function: Callable[..., Any], shapes: tuple) -> tuple[Program, Any]:
    """A function as a program of leaves, and the shapes of what it returns. It is traced here, and only once."""
    leaves, tree = jax.tree.flatten(shapes)
    returned = []

    def on_leaves(*leaves: Any) -> list:
        found, structure = jax.tree.flatten(function(*jax.tree.unflatten(tree, leaves)))
        returned.append(structure)
        return found

    jitted = jax.jit(on_leaves)
    traced = jitted.trace(*leaves)
    return Program(jitted, leaves), jax.tree.unflatten(returned[0], traced.out_info)


def _one_lane(scenarios: LandingScenario, lanes: int) -> LandingScenario:
    """Shapes of one scenario of a stack."""
    for name, leaf in named_leaves(scenarios):
        if leaf.shape[:1] != (lanes,):
            raise TypeError(f"{name}: a leading axis of {lanes} lanes expected, got shape {leaf.shape}")
    return jax.tree.map(lambda v: jax.ShapeDtypeStruct(v.shape[1:], v.dtype), scenarios)
