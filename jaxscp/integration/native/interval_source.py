"""The text before ``paths.cu`` and ``intervals.cu``: sizes, tableau, arrays, and the functions of a problem.

A function is a struct with its values, the nonzero entries of its derivatives, and products with these sparse matrices.
The products are written out, so that their operands are in registers.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from jaxscp.backends.codegen.cuda_text import COMPARISONS, Numbers, Scope, hoisted_slots, literal, numbered
from jaxscp.backends.codegen.functions import TapedFunction
from jaxscp.integration.interval_tapes import IntervalTapes, first_inputs
from jaxscp.integration.intervals import Intervals, OutputGroup

WARP, HALVES = 32, 2
PATH_THREADS = 32  # of a block whose threads integrate an interval each
NUMBER = 8  # bytes
EVEN_ROWS = "entries", "point_entries", "second", "point_second", "exchanged", "value_tangents"
"""Arrays whose rows have an even length, so that the compiler loads two numbers at once."""

Shapes = dict[str, tuple[int, ...]]


def halves(order: int) -> int:
    """Threads that share a column: the Hessian alone has work for two."""
    return HALVES if order > 1 else 1


def threads(inputs: int, order: int) -> int:
    """Threads of a block, in whole warps."""
    return halves(order) * -(-inputs // WARP) * WARP


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
        self.stored_arrays, self.shared_arrays = self._stored_arrays(), self._shared_arrays()
        common = "\n".join(self._lines())
        self.paths, self.columns = (f'{common}\n#include "{name}.cu"\n' for name in ("paths", "intervals"))

    @property
    def stored(self) -> int:
        """Numbers of an interval that the first kernel stores for the second."""
        return sum(int(np.prod(shape)) for shape in self.stored_arrays.values())

    @property
    def shared(self) -> int:
        """Bytes of the shared memory of a block."""
        return NUMBER * sum(_even(int(np.prod(shape))) for shape in self.shared_arrays.values())

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
        """Arrays that the first kernel stores for the second: names and shapes; those of higher orders are empty."""
        intervals, arguments = self.intervals, self.tapes.rate.arguments
        slopes = intervals.steps * intervals.method.stages
        values = {"values": (intervals.points * self.tapes.point.values,)}
        first_order = {"arguments": (slopes, arguments), **self._entries(1)}
        second_order = {
            "point_arguments": (intervals.points, arguments),
            "slope_adjoints": (slopes, intervals.states + 1),
            **self._entries(2),
        }
        return values | self._up_to_order(first_order, second_order, least=0)

    def _shared_arrays(self) -> Shapes:
        """Arrays in shared memory: names and shapes. One that a lower order does not need has a single number."""
        n, stages, tapes = self.intervals.states, self.intervals.method.stages, self.tapes
        of_halves = HALVES * -(-self.inputs // HALVES)
        first_order = {
            "arguments": (stages, tapes.rate.arguments),
            "entries": (stages, len(tapes.rate.jacobian)),
            "slope_tangents": (stages - 1, n, self.inputs),
            "value_tangents": (self.intervals.points * tapes.point.values, of_halves),
            **self._entries(1),
        }
        second_order = {
            "slope_adjoints": (stages, n + 1),
            "second": (stages, len(tapes.rate.hessian)),
            "exchanged": (of_halves, n),
            **self._entries(2),
        }
        found = self._up_to_order(first_order, second_order, least=1)
        return {name: (*v[:-1], _even(v[-1])) if name in EVEN_ROWS else v for name, v in found.items()}

    def _up_to_order(self, first_order: Shapes, second_order: Shapes, least: int) -> Shapes:
        """Arrays that are needed up to the order; ``least`` numbers along each axis of the others."""
        found = {}
        for order, arrays in enumerate((first_order, second_order), start=1):
            for name, shape in arrays.items():
                found[name] = tuple(max(least, size) if self.order >= order else least for size in shape)
        return found

    def _lines(self) -> Iterator[str]:
        intervals, tapes, method = self.intervals, self.tapes, self.intervals.method
        functions = {"Rate": tapes.rate, "Point": tapes.point, "Ends": tapes.ends}
        functions |= {f"Margin{i}": group.margin for i, group in enumerate(self.groups)}
        written, hoisted = [], 0
        for name, function in functions.items():
            struct = _Function(name, function, hoisted)
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
            "Threads": threads(self.inputs, self.order),
            "PathThreads": PATH_THREADS,
            "Halves": halves(self.order),
            "PointData": tapes.point.data,
            "EndsData": tapes.ends.data,
            "Hoisted": hoisted,
            "Shared": self.shared // NUMBER,
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
        yield "struct Shared {"
        for name, shape in self.shared_arrays.items():
            yield f"  alignas(16) double {name}{''.join(f'[{size}]' for size in shape)};"
        yield "};"
        first = first_inputs(tapes.rate.jacobian, intervals.states, self.inputs)
        yield _table("int", "first_input", first.tolist())
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


class _Function:
    """Writer of a function's struct.

    Args:
        name: name of the struct.
        function: the function.
        at: index of the function's first hoisted constant.
    """

    def __init__(self, name: str, function: TapedFunction, at: int) -> None:
        self.name, self.function = name, function
        counts = [len(hoisted_slots(tape, function.inputs)) for tape in (function.first, function.second)]
        self.begins, self.hoisted = [at, at + counts[0]], sum(counts)

    def lines(self) -> Iterator[str]:
        """Lines of the struct."""
        f = self.function
        yield f"struct {self.name} {{"
        sizes = {"Arguments": f.arguments, "Values": f.values, "MostValues": max(1, f.values)}
        sizes |= {
            "Entries": len(f.jacobian),
            "MostEntries": max(1, len(f.jacobian)),
            "Second": len(f.hessian),
        }
        yield from (f"  static constexpr int k{name} = {value};" for name, value in sizes.items())
        yield from self.evaluation("values", 0, range(f.values))
        yield from self.evaluation("jacobian", 0, range(f.values, f.values + len(f.jacobian)))
        yield from self.evaluation("hessian", 1, range(len(f.hessian)))
        entries = [(i, r, c) for i, (r, c) in enumerate(f.jacobian.tolist())]
        yield from _product("times", entries)
        yield from _product("transposed", [(i, c, r) for i, r, c in entries])
        both = _both_triangles(f.hessian)
        yield from _product("hessian_times", both)
        with_curvature = {r for _, r, _ in both}
        yield "  static " + _table("bool", "curved", [int(r in with_curvature) for r in range(f.arguments)])
        yield "};"

    def evaluation(self, name: str, order: int, outputs: Sequence[int]) -> Iterator[str]:
        """A function that writes some outputs of a tape."""
        f, tape = self.function, (self.function.first, self.function.second)[order]
        of_multipliers = "const Multipliers& y, " if order else ""
        constants = "const double* d, const double* hoisted"
        also = "class Multipliers, " if order else ""
        yield f"  template <class From, {also}class To>"
        yield f"  static void {name}(const From& a, {of_multipliers}{constants}, To&& to) {{"
        inputs = [
            *(f"a[{i}]" for i in range(f.arguments)),
            *(f"y[{i}]" for i in range(f.values)),
            *(f"d[{i}]" for i in range(f.data)),
        ]
        if outputs:
            numbers = numbered(tape, f.inputs)
            yield f"    hoisted += {self.begins[order]};"
            scope = Scope(numbers, [f"in{i}" for i in range(f.inputs)], "v")
            body = [line for output in outputs for line in scope.make(numbers.outputs[output])]
            read = _inputs_read(numbers, [numbers.outputs[o] for o in outputs], f.inputs)
            yield from (f"    const double in{i} = {inputs[i]};" for i in read)
            yield from (f"    {line}" for line in body)
            for i, output in enumerate(outputs):
                yield f"    to[{i}] = {scope.names[numbers.outputs[output]]};"
        yield "  }"


def _even(count: int) -> int:
    return count + count % 2


def _inputs_read(numbers: Numbers, outputs: Sequence[int], inputs: int) -> list[int]:
    """Inputs that some outputs depend on."""
    seen, waiting = set(outputs), list(outputs)
    while waiting:
        _, operands = numbers.operations.get(waiting.pop(), (0, []))
        waiting += [v for v in operands if v not in seen]
        seen.update(operands)
    return sorted(v for v in seen if v < inputs)


def _both_triangles(lower: np.ndarray) -> list[tuple[int, int, int]]:
    """(entry, row, column) of a symmetric matrix, from the positions in its lower triangle."""
    entries = [(i, r, c) for i, (r, c) in enumerate(lower.tolist())]
    return entries + [(i, c, r) for i, r, c in entries if r != c]


def _product(name: str, entries: Iterable[tuple[int, int, int]]) -> Iterator[str]:
    """A function: to += matrix * from, for a sparse matrix with (entry, row, column)."""
    yield "  template <class Entries, class From, class To>"
    yield f"  static void {name}(const Entries& e, const From& from, To& to) {{"
    yield from (f"    to[{r}] = fma(e[{i}], from[{c}], to[{r}]);" for i, r, c in entries)
    yield "  }"


def _table(kind: str, name: str, entries: Sequence[int]) -> str:
    """A function of an index; the compiler knows its value where it knows the index."""
    listed = ", ".join(map(str, entries)) or "0"
    return f"constexpr {kind} {name}(int i) {{ constexpr {kind} of[] = {{{listed}}}; return of[i]; }}"


def _row(numbers: np.ndarray) -> str:
    return ", ".join(map(literal, numbers.tolist()))
