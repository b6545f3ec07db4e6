"""A function of a problem as a struct in CUDA, from its tapes.

It has the function's values, the nonzero entries of its derivatives, and products with these sparse matrices. The
products are written out, so that their operands are in registers.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from jaxscp.backends.codegen.cuda_text import Numbers, Scope, hoisted_slots, numbered
from jaxscp.backends.codegen.functions import TapedFunction


class FunctionSource:
    """Writer of a function's struct.

    Args:
        name: name of the struct.
        function: the function.
        states: size of the state.
        at: index of the function's first hoisted constant.
    """

    def __init__(self, name: str, function: TapedFunction, states: int, at: int) -> None:
        self.name, self.function, self.states = name, function, states
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
            "MostSecond": max(1, len(f.hessian)),
        }
        yield from (f"  static constexpr int k{name} = {value};" for name, value in sizes.items())
        yield from self.evaluation("values", 0, range(f.values))
        yield from self.evaluation("jacobian", 0, range(f.values, f.values + len(f.jacobian)))
        yield from self.evaluation("hessian", 1, range(len(f.hessian)))
        entries = [(i, r, c) for i, (r, c) in enumerate(f.jacobian.tolist())]
        yield from _product("times", entries)
        yield from _product("transposed", [(i, c, r) for i, r, c in entries])
        yield from _product("hessian_times", _both_triangles(f.hessian))
        yield f"  static constexpr int kCurved = {len(chosen := curved(f, self.states))};"
        yield "  static " + positions("curved_row", chosen, self.states)
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


def curved(function: TapedFunction, states: int) -> list[int]:
    """States that a function has second derivatives in."""
    return sorted({i for entry in function.hessian.tolist() for i in entry if i < states})


def positions(name: str, chosen: Sequence[int], count: int) -> str:
    """A function of an index below the count, known to the compiler: its position among the chosen ones, or -1."""
    listed = ", ".join(str(chosen.index(i)) if i in chosen else "-1" for i in range(max(1, count)))
    return f"constexpr int {name}(int i) {{ constexpr int of[] = {{{listed}}}; return of[i]; }}"
