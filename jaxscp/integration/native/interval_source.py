"""The text before ``paths.cu`` and ``intervals.cu``: sizes, tableau, arrays, and the functions of a problem."""

from collections.abc import Iterator

import numpy as np

from jaxscp.backends.codegen.cuda_text import COMPARISONS, literal
from jaxscp.backends.codegen.functions import TapedFunction
from jaxscp.integration.interval_tapes import IntervalTapes
from jaxscp.integration.intervals import Intervals, OutputGroup
from jaxscp.integration.native.function_source import FunctionSource, curved, positions

WARP = 32
SQUARE = 8  # rows and columns of a tensor core's sums
BANK_SHIFT = 4  # of rows, four of which are read at once, from different banks of memory
PATH_THREADS = 32  # of a block whose threads integrate an interval each
NUMBER = 8  # bytes

Shapes = dict[str, tuple[int, ...]]


def threads(inputs: int) -> int:
    """Threads of a block that finds derivatives, a column each, in whole warps."""
    return -(-inputs // WARP) * WARP


class Source:
    """The texts of both kernels, and the sizes of their arrays.

    Args:
        intervals: the integration.
        tapes: its functions.
        inputs: size of w.
        order: highest derivative.
    """

    def __init__(self, intervals: Intervals, tapes: IntervalTapes, inputs: int, order: int) -> None:
        self.intervals, self.tapes, self.inputs, self.order = intervals, tapes, inputs, order
        groups = intervals.path_outputs.groups
        self.groups = [_Group(g, f) for g, f in zip(groups, tapes.margins, strict=True)]
        if (rows := sum(group.rows for group in groups)) != tapes.point.values:
            raise ValueError(f"path outputs: groups of {rows} rows, but {tapes.point.values} at a point")
        self.row = -(-inputs // SQUARE) * SQUARE + BANK_SHIFT
        self.stored_arrays, self.shared_arrays = self._stored_arrays(), self._shared_arrays()
        common = "\n".join(self._lines())
        self.paths, self.columns = (f'{common}\n#include "{name}.cu"\n' for name in ("paths", "intervals"))

    @property
    def stored(self) -> int:
        """Numbers of an interval that the first kernel stores for itself and the second, but for the slopes'."""
        return sum(int(np.prod(shape)) for shape in self.stored_arrays.values())

    @property
    def stored_of_slopes(self) -> int:
        """Numbers of the slopes' derivatives that it stores, interval after interval."""
        return self.intervals.steps * self.intervals.method.stages * self._slope_entries() * (self.order > 0)

    def _slope_entries(self) -> int:
        rate = self.tapes.rate
        return sum(_even(max(1, len(entries))) for entries in (rate.jacobian, rate.hessian))

    @property
    def shared_by_paths(self) -> int:
        """Bytes of the shared memory of a block of the first kernel."""
        return NUMBER * PATH_THREADS * (self._slope_entries() + 1)

    @property
    def shared(self) -> int:
        """Bytes of the shared memory of a block of the second kernel."""
        numbers = lambda arrays: sum(int(np.prod(shape)) for shape in arrays.values())  # noqa: E731
        return NUMBER * max(map(numbers, self.shared_arrays.values()))

    def _entries(self, order: int) -> Shapes:
        """Entries of derivatives of an order at points and ends, and of margins: names and shapes."""
        tapes, points = self.tapes, self.intervals.points
        count = lambda f: len((f.jacobian, f.hessian)[order - 1])  # noqa: E731
        name = ("entries", "second")[order - 1]
        return {
            f"point_{name}": (points, count(tapes.point)),
            f"ends_{name}": (count(tapes.ends),),
            f"margin_{name}": (sum(g.instances * count(g.margin) for g in self.groups),),
        }

    def _stored_arrays(self) -> Shapes:
        """Arrays that the first kernel stores for the second: names and shapes; arrays of higher orders are empty."""
        intervals, arguments = self.intervals, self.tapes.rate.arguments
        slopes = intervals.steps * intervals.method.stages
        values = {"values": (intervals.points * self.tapes.point.values,)}
        first_order = self._entries(1)
        second_order = {
            "arguments": (slopes, arguments),
            "point_arguments": (intervals.points, arguments),
            **self._entries(2),
        }
        return values | self._up_to_order(first_order, second_order)

    def _up_to_order(self, first_order: Shapes, second_order: Shapes) -> Shapes:
        """Arrays that are needed up to the order; the others are empty."""
        return {
            name: tuple(size * (self.order >= order) for size in shape)
            for order, arrays in enumerate((first_order, second_order), start=1)
            for name, shape in arrays.items()
        }

    def _shared_arrays(self) -> dict[str, Shapes]:
        """Arrays in shared memory, in three uses that follow each other: names and shapes.

        Rows have an even length, as two numbers are loaded at once.
        """
        tapes, stages, row = self.tapes, self.intervals.method.stages, self.row
        of_order = {1: self._entries(1), 2: self._entries(2)}
        most = max(len(curved(f, self.intervals.states)) for f in (tapes.rate, tapes.point))
        integrating = {
            "slope_entries": (stages, self._slope_entries()),
            "slope_tangents": (stages - 1, len(self._needed()), self.inputs),
            "point_entries": of_order[1]["point_entries"],
            "point_second": of_order[2]["point_second"],
            "tangents": (most, row),
            "products": (most, row),
        }
        margins = {
            "tangents": (self.intervals.points * tapes.point.values, row),
            "entries": of_order[1]["margin_entries"],
            "second": of_order[2]["margin_second"],
            "products": (max((group.margin.arguments for group in self.groups), default=0), row),
        }
        uses = {"Integrating": integrating, "Margins": margins, "Sums": {"hessian": (self.inputs, row)}}
        return {
            use: {name: (*(max(1, s) for s in v[:-1]), _even(max(1, v[-1]))) for name, v in arrays.items()}
            for use, arrays in uses.items()
        }

    def _needed(self) -> list[int]:
        """States that the rate depends on."""
        return sorted(
            {column for _, column in self.tapes.rate.jacobian.tolist() if column < self.intervals.states}
        )

    def _lines(self) -> Iterator[str]:
        intervals, tapes, method = self.intervals, self.tapes, self.intervals.method
        functions = {"Rate": tapes.rate, "Point": tapes.point, "Ends": tapes.ends}
        functions |= {f"Margin{i}": group.margin for i, group in enumerate(self.groups)}
        written, hoisted = [], 0
        for name, function in functions.items():
            struct = FunctionSource(name, function, intervals.states, hoisted)
            written.append("\n".join(struct.lines()))
            hoisted += struct.hoisted
        sizes = {
            "Order": self.order,
            "States": intervals.states,
            "Controls": intervals.controls(self.inputs),
            "Inputs": self.inputs,
            "Steps": intervals.steps,
            "StepsPerSubinterval": intervals.steps_per_subinterval,
            "Stages": method.stages,
            "Points": intervals.points,
            "Threads": threads(self.inputs),
            "PathThreads": PATH_THREADS,
            "Row": self.row,
            "PointData": tapes.point.data,
            "EndsData": tapes.ends.data,
            "Hoisted": hoisted,
            "Shared": self.shared // NUMBER,
            "SlopeEntries": self._slope_entries(),
            "PathShared": self.shared_by_paths // NUMBER,
            "MarginEntries": self.stored_arrays["margin_entries"][0],
            "MarginSecond": self.stored_arrays["margin_second"][0],
        }
        begin = 0
        for name, shape in self.stored_arrays.items():
            sizes[f"{name.title().replace('_', '')}At"] = begin
            begin += int(np.prod(shape))
        yield COMPARISONS
        yield from (f"constexpr int k{name} = {value};" for name, value in sizes.items())
        yield f"__constant__ double kC[kStages] = {{{_row(method.c)}}};"
        yield f"__constant__ double kB[kStages] = {{{_row(method.b)}}};"
        yield f"__constant__ double kA[kStages][kStages] = {{{', '.join(f'{{{_row(a)}}}' for a in method.a)}}};"
        for use, arrays in self.shared_arrays.items():
            yield f"struct {use} {{"
            for name, shape in arrays.items():
                yield f"  alignas(16) double {name}{''.join(f'[{size}]' for size in shape)};"
            yield "};"
        yield "union Shared {"
        yield from (f"  {use} {use.lower()};" for use in self.shared_arrays)
        yield "};"
        yield positions("needed_row", self._needed(), intervals.states)
        yield from written
        yield from self._group_lines()

    def _group_lines(self) -> Iterator[str]:
        """A struct for each group, and the loop over groups."""
        first = entries = second = 0
        for i, g in enumerate(self.groups):
            numbers = {"Rows": g.rows, "Size": g.size, "Instances": g.instances, "First": first}
            constants = ", ".join(f"k{name} = {value}" for name, value in numbers.items())
            yield f"struct Group{i} {{"
            yield f"  using Margin = Margin{i};"
            yield f"  static constexpr int {constants};"
            yield f"  static constexpr int entries_of(int k) {{ return {entries} + k * Margin::kEntries; }}"
            yield f"  static constexpr int second_of(int k) {{ return {second} + k * Margin::kSecond; }}"
            yield "};"
            first += g.rows
            entries += g.instances * len(g.margin.jacobian)
            second += g.instances * len(g.margin.hessian)
        calls = " ".join(f"act(Group{i}());" for i in range(len(self.groups)))
        yield f"template <typename Act> inline void for_groups(Act act) {{ {calls} }}"


class _Group:
    """A group of rows and its margin."""

    def __init__(self, group: OutputGroup, margin: TapedFunction) -> None:
        self.rows, self.size, self.margin = group.rows, group.group_size, margin
        self.instances = group.rows // group.group_size


def _even(count: int) -> int:
    return count + count % 2


def _row(numbers: np.ndarray) -> str:
    return ", ".join(map(literal, numbers.tolist()))
