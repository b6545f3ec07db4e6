"""Any number of scenarios by one compiled program: on the threads of a CPU, or batch by batch on other devices."""

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxscp.aot.aot import one_element, with_arrays
from jaxscp.aot.pytree_spec import difference, spec_of
from jaxscp.core.errors import InvalidScenario
from jaxscp.core.threads import in_order, usable_cores
from jaxscp.solver.pipeline import Pipeline
from jaxscp.solver.scenario import Scenario

BATCH_ELSEWHERE = 1024  # scenarios of a program on devices other than CPUs
THREADS_ELSEWHERE = 2  # one prepares and copies, while the other one's batch is planned

Leaves = list[np.ndarray]
Progress = Callable[[int, int | None], Any]


class Many(NamedTuple):
    """How to plan many scenarios.

    Args:
        batch_size: scenarios of a program; None for the device's usual one.
        workers: threads; None for the device's usual number.
        devices: of one platform, which share each batch; JAX's default device if empty.
    """

    batch_size: int | None = None
    workers: int | None = None
    devices: tuple[Any, ...] = ()

    def check(self) -> None:
        """Raise an error that names the argument."""
        for name in ("batch_size", "workers"):
            value = getattr(self, name)
            if value is not None and (not isinstance(value, int | np.integer) or value < 1):
                raise ValueError(f"{name}: expected a whole number, 1 or more, or None; got {value!r}.")
        good = isinstance(self.devices, tuple) and all(isinstance(one, jax.Device) for one in self.devices)
        if not good:
            raise ValueError(
                f"devices: expected a tuple of JAX's devices, tuple(jax.devices()) say; got {self.devices!r}."
            )
        if self.devices and self._size() % len(self.devices):
            raise ValueError(
                f"batch_size: must be a multiple of the number of devices, {len(self.devices)}; got {self._size()}."
            )

    def axis(self) -> int | None:
        """Elements of the program's leading axis; None for a program of one scenario, the planner's own."""
        return None if self._size() == 1 and not self.devices else self._size()

    def threads(self) -> int:
        """Number of threads."""
        alone = self.axis() is None
        return self.workers or (usable_cores() if alone else THREADS_ELSEWHERE)

    def _size(self) -> int:
        on_cpu = jax.default_backend() == "cpu"
        return self.batch_size or (max(1, len(self.devices)) if on_cpu else BATCH_ELSEWHERE)


class _Inputs(NamedTuple):
    """The scenarios as leaves on the host."""

    like: Any
    """Inputs of one scenario, of ``jax.ShapeDtypeStruct``."""
    chunks: Callable[[int], Iterable[Leaves]]
    """From a size, all scenarios in chunks of that size or fewer, stacked."""
    total: int | None
    """Number of scenarios; None if not known."""


def solve_many(
    pipeline: Pipeline,
    scenarios: Scenario | Iterable[Scenario],
    how: Many,
    keep: Callable[[Any], Any] | None = None,
    progress: Progress | None = None,
) -> Any:
    """Solutions, stacked, as NumPy arrays.

    Args:
        pipeline: that solves.
        scenarios: one pytree with a leading axis, or any iterable of scenarios of one shape.
        how: batches, threads and devices.
        keep: from stacked solutions to the part that is returned; all by default.
        progress: called with the numbers of finished scenarios and of all, None if unknown.

    Raises:
        InvalidScenario: if a shape is wrong; the message names the field.
        ValueError: if another argument is wrong.
    """
    how.check()
    for name, function in (("keep", keep), ("progress", progress)):
        if function is not None and not callable(function):
            raise ValueError(f"{name}: expected a function or None, got {function!r}.")
    inputs = _inputs(pipeline, scenarios)
    axis = how.axis()
    program = pipeline.program(inputs.like, axis, how.devices)
    tree = jax.tree.structure(inputs.like)

    def run(chunk: Leaves) -> tuple[int, Any]:
        count = len(chunk[0])
        if axis is None:
            one = [np.asarray(v[0]) for v in chunk]
            found = jax.tree.map(lambda v: v[None], jax.device_get(program(jax.tree.unflatten(tree, one))))
        else:
            full = [_padded(v, axis) for v in chunk]
            found = jax.device_get(program(jax.tree.unflatten(tree, full)))
            found = jax.tree.map(lambda v: v[:count], found)
        return count, found if keep is None else keep(found)

    parts, done = [], 0
    in_flight = None if axis is None else 2 * how.threads()  # a batch is large
    for count, part in in_order(run, inputs.chunks(axis or 1), how.threads(), in_flight):
        parts.append(part)
        done += count
        if progress is not None:
            progress(done, inputs.total)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def _padded(v: np.ndarray, size: int) -> np.ndarray:
    """The array with its last entry repeated up to a size."""
    return v if len(v) == size else np.concatenate([v, np.repeat(v[-1:], size - len(v), axis=0)])


def _stacked(elements: Iterable[Leaves], size: int) -> Iterator[Leaves]:
    """Chunks of leaves of one scenario each."""
    rest = iter(elements)
    while chunk := list(itertools.islice(rest, size)):
        yield [np.stack(leaves) for leaves in zip(*chunk, strict=True)]


def _inputs(pipeline: Pipeline, scenarios: Any) -> _Inputs:
    if isinstance(scenarios, Scenario):
        return _of_stack(pipeline, scenarios)
    if not isinstance(scenarios, Iterable):
        raise InvalidScenario(
            f"scenarios: expected scenarios, or one with a leading axis, got a {type(scenarios).__name__}."
        )
    rest = iter(scenarios)
    if (first := next(rest, None)) is None:
        raise InvalidScenario("scenarios: there are none, and so no shape of the solutions.")
    if not isinstance(first, Scenario):
        raise InvalidScenario(f"scenarios[0]: expected a scenario, got a {type(first).__name__}.")
    first = with_arrays(first)
    pipeline.check_shapes(first)  # of values, the status tells
    like = jax.tree.map(_shape_of, first.solver_inputs())
    total = len(scenarios) if hasattr(scenarios, "__len__") else None  # pyright: ignore[reportArgumentType]
    elements = _of_each(like, itertools.chain([first], rest))
    return _Inputs(like, functools.partial(_stacked, elements), total)


def _of_stack(pipeline: Pipeline, scenarios: Any) -> _Inputs:
    """Elements of one pytree with a leading axis."""
    stack = with_arrays(scenarios)
    leaves = jax.tree.leaves(stack)
    if not leaves or not leaves[0].ndim or not leaves[0].shape[0]:
        raise InvalidScenario("scenarios: expected a leading axis of one scenario or more on every array.")
    size = leaves[0].shape[0]
    try:
        one = one_element(stack, size)
    except TypeError as error:
        raise InvalidScenario(f"scenarios.{error}") from error
    pipeline.check(one)
    arrays = jax.device_get(jax.tree.leaves(stack.solver_inputs()))

    def chunks(most: int) -> Iterator[Leaves]:
        return ([v[i : i + most] for v in arrays] for i in range(0, size, most))

    return _Inputs(one.solver_inputs(), chunks, size)


def _of_each(like: Any, scenarios: Iterable[Any]) -> Iterator[Leaves]:
    """Leaves of scenarios, which must have the first one's shape."""
    expected = _shapes(like)
    for number, scenario in enumerate(scenarios):
        if not isinstance(scenario, Scenario):
            raise InvalidScenario(
                f"scenarios[{number}]: expected a scenario, got a {type(scenario).__name__}."
            )
        inputs = with_arrays(scenario).solver_inputs()
        if _shapes(inputs) != expected:
            differs = difference(spec_of(like), spec_of(inputs))
            raise InvalidScenario(
                f"scenarios[{number}]: {differs}. Map scenarios of each shape by themselves."
            )
        yield jax.device_get(jax.tree.leaves(inputs))


def _shapes(tree: Any) -> Any:
    leaves, structure = jax.tree.flatten(tree)
    return structure, [(v.shape, v.dtype) for v in leaves]


def _shape_of(v: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(v.shape, v.dtype)
