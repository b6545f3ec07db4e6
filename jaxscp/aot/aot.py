"""Planners compiled ahead of their first call: for one shape of input, in this process or from a file.

A planner is three programs; each takes the outputs of the one before. Here they are functions of leaves, so that
neither a call nor a file needs the pytrees between them.
"""

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jax.core import Tracer

from jaxscp.aot.pytree_spec import Spec, difference, spec_of
from jaxscp.backends.xla import compiler_options
from jaxscp.core.arrays import as_floats
from jaxscp.core.trees import named_leaves

Leaves = Sequence[Any]


@runtime_checkable
class Checked(Protocol):
    """An input that can check itself, and say which of its parts a program reads."""

    def check(self, nodes: int) -> None:
        """Raise an error that names the field. Leaves may be ``jax.ShapeDtypeStruct``: then shapes and dtypes count."""
        ...

    def solver_inputs(self) -> Any:
        """The parts that programs read, as a pytree."""
        ...


class Program(NamedTuple):
    """One of a planner's programs, not compiled yet."""

    function: Any
    """Jitted; from leaves to a list of leaves."""
    shapes: Leaves
    """Of its arguments: ``jax.ShapeDtypeStruct``."""


class TracedPlanner(NamedTuple):
    """All programs of a planner, traced."""

    nodes: int
    batch_size: int | None
    scenario: Spec
    """Of one input."""
    solution: Any
    """A solution of ``jax.ShapeDtypeStruct``, with a leading axis for the batch."""
    setup: Program
    solve: Program
    conclude: Program

    @property
    def programs(self) -> dict[str, Program]:
        """By their names, in the order of their calls."""
        return {"setup": self.setup, "solve": self.solve, "conclude": self.conclude}


def compile_programs(programs: dict[str, Program]) -> dict[str, jax.stages.Compiled]:
    """The programs compiled for this machine, in parallel; they take and return leaves."""
    with ThreadPoolExecutor() as threads:
        compiling = {}
        # the largest first: Python lowers one program while threads compile the others
        for name in sorted(programs, key=lambda name: name != "solve"):
            lowered = programs[name].function.lower(*programs[name].shapes)
            compiling[name] = threads.submit(lowered.compile, compiler_options=compiler_options())
        return {name: compiling[name].result() for name in programs}


@dataclasses.dataclass(frozen=True)
class CompiledPlanner:
    """A planner for inputs of one shape, compiled before its first call; a call traces nothing.

    ``Planner.compile`` and ``jaxscp.load`` make these. Solutions equal the planner's bitwise. For derivatives,
    ``vmap`` and re-plans, use the planner itself.
    """

    nodes: int
    batch_size: int | None
    """Inputs a call; None for one without a leading axis."""
    scenario: Spec = dataclasses.field(repr=False)
    solution: Any = dataclasses.field(repr=False)
    """Tree structure of a solution."""
    setup: Callable[..., Leaves] = dataclasses.field(repr=False)
    solve: Callable[..., Leaves] = dataclasses.field(repr=False)
    conclude: Callable[..., Leaves] = dataclasses.field(repr=False)

    def __call__(self, scenario: Checked) -> Any:
        """The solution of a scenario, or of ``batch_size`` of them, stacked.

        Raises:
            InvalidScenario: if the scenario contradicts itself. In a batch, the status of that element is
                ``invalid_input``.
            TypeError: if parts, shapes or dtypes are not those that the planner was compiled for; the message names
                the field. The number of ``obstacles``, for pictures, is free.
        """
        scenario = with_arrays(scenario)
        self._check(scenario)
        return self.run(scenario.solver_inputs())

    def run(self, inputs: Any) -> Any:
        """The solution for checked inputs."""
        return self.run_from(self.setup(*jax.tree.leaves(inputs)))

    def run_from(self, begun: Any) -> Any:
        """The solution from the outputs of ``setup``, or others of the same shapes."""
        leaves = self.conclude(*self.solve(*jax.tree.leaves(begun)))
        return jax.tree.unflatten(self.solution, leaves)

    def _check(self, scenario: Checked) -> None:
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scenario)):
            raise TypeError(
                "a compiled planner takes arrays; inside jit, vmap and grad, call the Planner itself"
            )
        one = scenario if self.batch_size is None else one_element(scenario, self.batch_size)
        one.check(self.nodes)
        differs = difference(self.scenario, spec_of(one.solver_inputs()))
        if differs:
            raise TypeError(f"the planner was compiled for scenarios of another shape: {differs}")


def with_arrays(scenario: Checked) -> Any:
    """A scenario whose numbers of Python and NumPy, set by ``eqx.tree_at`` say, are arrays; masks stay masks."""
    is_mask = lambda v: isinstance(v, np.ndarray) and v.dtype.kind == "b"  # noqa: E731
    return jax.tree.map(lambda v: v if is_mask(v) else as_floats(v), scenario)


def trace(
    parts: Sequence[Callable[..., Any]],
    scenario: Checked,
    nodes: int,
    batch_size: int | None,
    devices: Sequence[Any] = (),
) -> TracedPlanner:
    """Trace the programs of a planner.

    Args:
        parts: the first takes the inputs of a scenario, each other one the outputs of the one before; the last returns
            a solution.
        scenario: one; only its shapes and dtypes matter.
        nodes: N of the planner.
        batch_size: scenarios at once; None for one without a leading axis.
        devices: that share a batch; JAX's default one if empty.
    """
    shape_of = lambda axis: lambda v: jax.ShapeDtypeStruct(axis + v.shape, v.dtype)  # noqa: E731
    one = jax.tree.map(lambda v: shape_of(())(v) if hasattr(v, "dtype") else v, scenario)
    one.check(nodes)
    inputs = one.solver_inputs()
    axis = () if batch_size is None else (batch_size,)
    shapes: Any = (jax.tree.map(shape_of(axis), inputs),)
    programs = []
    for part in parts:
        program, shapes = _program(part if batch_size is None else batched(part, devices), shapes, devices)
        programs.append(program)
    return TracedPlanner(nodes, batch_size, spec_of(inputs), shapes, *programs)


def compiled(traced: TracedPlanner) -> CompiledPlanner:
    """The planner, compiled for this machine."""
    return with_programs(traced, compile_programs(traced.programs))


def with_programs(traced: TracedPlanner, programs: dict[str, Callable[..., Leaves]]) -> CompiledPlanner:
    """The planner with these compiled programs."""
    tree = jax.tree.structure(traced.solution)
    return CompiledPlanner(traced.nodes, traced.batch_size, traced.scenario, tree, **programs)


def batched(function: Callable[..., Any], devices: Sequence[Any] = ()) -> Callable[..., Any]:
    """``jax.vmap`` of a function; with devices, each takes its share of the leading axis."""
    if not devices:
        return jax.vmap(function)
    share = _share_of(devices)
    # loops end at other times on each device, and no device needs another's data
    return jax.shard_map(
        jax.vmap(function), mesh=share.mesh, in_specs=share.spec, out_specs=share.spec, check_vma=False
    )


def _share_of(devices: Sequence[Any]) -> jax.sharding.NamedSharding:
    """Arrays whose leading axis is divided among devices."""
    mesh = jax.sharding.Mesh(np.asarray(devices), ("batch",))
    return jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("batch"))


def _program(function: Callable[..., Any], shapes: tuple, devices: Sequence[Any]) -> tuple[Program, Any]:
    """A function as a program of leaves, and the shapes of its outputs. It is traced here, and only once."""
    leaves, tree = jax.tree.flatten(shapes)
    returned = []

    def on_leaves(*leaves: Any) -> list:
        outputs, structure = jax.tree.flatten(function(*jax.tree.unflatten(tree, leaves)))
        returned.append(structure)
        return outputs

    shardings = dict.fromkeys(("in_shardings", "out_shardings"), _share_of(devices)) if devices else {}
    jitted = jax.jit(on_leaves, **shardings)
    traced = jitted.trace(*leaves)
    shape_of = lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype)  # noqa: E731
    return Program(jitted, leaves), jax.tree.unflatten(returned[0], jax.tree.map(shape_of, traced.out_info))


def one_element(scenarios: Any, size: int) -> Any:
    """Shapes of one element of a stack."""
    for name, leaf in named_leaves(scenarios):
        if leaf.shape[:1] != (size,):
            raise TypeError(f"{name}: a leading axis of {size} elements expected, got shape {leaf.shape}")
    return jax.tree.map(lambda v: jax.ShapeDtypeStruct(v.shape[1:], v.dtype), scenarios)
