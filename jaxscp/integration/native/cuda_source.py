"""Text of the CUDA kernel that integrates intervals, made from the tape of the rate.

A thread carries some columns of an interval's tangent through all steps, and integrates the state itself: the threads
of an interval repeat their common work, and none waits for another. The formulas equal those in ``in_tape.linearise``.

Registers hold half of the numbers, so that as few as possible must be live. Therefore every slope is added to later
stages and to the step's end at once. Operations stand just before their first use. Hoisted constants and controls are
read again at every stage.
"""

from collections.abc import Iterator

from jaxscp.backends.codegen.cuda_text import COMPARISONS, Scope, filled, literal, numbered
from jaxscp.backends.codegen.functions import TapedFunction
from jaxscp.integration.tableaus import Method

THREADS = 128  # threads of a block

_BEGIN = """\
constexpr int kColumns = @columns, kGroupSize = @group_size, kInputs = @inputs, kRows = @rows, kHoisted = @hoisted;

// A row of the tangent: this thread's columns.
struct Row {
  double at[kColumns];
};

// to += factor * row
inline void add(Row& to, double factor, const Row& row) {
#pragma unroll
  for (int c = 0; c < kColumns; ++c) to.at[c] = fma(factor, row.at[c], to.at[c]);
}

// The same address, hidden from the optimiser, which would otherwise keep all numbers read there in registers.
inline const double* opaque(const double* from) {
#ifdef __CUDACC__
  asm volatile("" : "+l"(from));
#endif
  return from;
}

// ``intervals`` intervals share hoisted constants; there are ``count`` in all.
extern "C" __global__ void __launch_bounds__(@threads)
    jaxscp_kernel(const double* __restrict__ w, const double* __restrict__ hoisted, double* __restrict__ outputs,
                  double* __restrict__ jacobian, long long count, long long intervals) {
  const long long thread = static_cast<long long>(blockIdx.x) * @threads + threadIdx.x;
  const long long interval = thread / kGroupSize;
  if (interval >= count) return;
  const int member = static_cast<int>(thread - interval * kGroupSize);
  w += interval * kInputs;
  hoisted += interval / intervals * kHoisted;

  // Tangent of an input, and of a control at a fraction of the interval.
  auto input_tangent = [&](int input) {
    Row row;
#pragma unroll
    for (int c = 0; c < kColumns; ++c) row.at[c] = member + c * kGroupSize == input ? 1.0 : 0.0;
    return row;
  };
  auto control_tangent = [&](int first, int last, double fraction) {
    Row row;
#pragma unroll
    for (int c = 0; c < kColumns; ++c) {
      const int column = member + c * kGroupSize;
      row.at[c] = column == first ? 1.0 - fraction : column == last ? fraction : 0.0;
    }
    return row;
  };
"""

_END = """\
  auto write = [&](int row, double value, const Row& tangent) {
    if (member == 0) outputs[interval * kRows + row] = value;
#pragma unroll
    for (int c = 0; c < kColumns; ++c) {
      const int column = member + c * kGroupSize;
      if (column < kInputs) jacobian[(interval * kRows + row) * kInputs + column] = tangent.at[c];
    }
  };"""


def group_size(inputs: int, columns: int) -> int:
    """Threads of an interval with so many inputs, each thread with so many columns at most."""
    return -(-inputs // columns)


def kernel(rate: TapedFunction, states: int, method: Method, steps: int, columns: int) -> str:
    """Text of the kernel.

    Args:
        rate: time derivative of states and cost, a function of states and controls without data.
        states: size of the state.
        method: Butcher tableau.
        steps: Runge-Kutta steps of an interval.
        columns: columns of the tangent in a thread's registers.
    """
    return "\n".join(_Writer(rate, states, method, steps).lines(columns)) + "\n"


class _Writer:
    """Writer of the kernel's lines."""

    def __init__(self, rate: TapedFunction, states: int, method: Method, steps: int) -> None:
        self.rate, self.n, self.method, self.steps = rate, states, method, steps
        self.m, self.rows = rate.arguments - states, rate.values
        self.inputs = states + 2 * self.m
        self.numbers = numbered(rate.first, rate.inputs)
        self.entries: list[list[tuple[int, int]]] = [[] for _ in range(self.rows)]
        """By row of the Jacobian: column, and number."""
        entries = zip(rate.jacobian.tolist(), self.numbers.outputs[self.rows :], strict=True)
        for (row, column), number in entries:
            self.entries[row].append((column, number))
        self.declared: set[tuple[int, int]] = set()
        """(stage, row) with variables of their own; all others are equal to the step's begin. The step's end counts as
        the last stage."""

    def lines(self, columns: int) -> Iterator[str]:
        """Lines of the kernel."""
        n = self.n
        numbers = {"columns": columns, "group_size": group_size(self.inputs, columns), "inputs": self.inputs}
        numbers |= {"rows": self.rows, "hoisted": len(self.numbers.hoisted), "threads": THREADS}
        yield filled(COMPARISONS + _BEGIN, numbers)
        for r in range(self.rows):
            yield f"  double x{r} = {f'w[{r}]' if r < n else '0.0'};"
            yield f"  Row dx{r} = {f'input_tangent({r})' if r < n else '{}'};"
        yield "#pragma unroll 1"
        yield f"  for (int step = 0; step < {self.steps}; ++step) {{"
        yield from (f"    {line}" for line in self.step())
        yield "  }"
        yield _END
        for r in range(self.rows):
            yield f"  write({r}, x{r}, dx{r});"
        yield "}"

    def step(self) -> Iterator[str]:
        """Stage after stage, each followed by the sums that its slopes enter."""
        method, size = self.method, 1.0 / self.steps
        weights = [*method.a.tolist(), method.b.tolist()]
        for stage, c in enumerate(method.c.tolist()):
            yield f"const double fraction{stage} = {literal(size)} * (step + {literal(c)});"
            later = range(stage + 1, method.stages + 1)
            to = {target: size * weights[target][stage] for target in later if weights[target][stage]}
            yield from self.stage(stage, to)
        for r in range(self.rows):
            yield f"x{r} = {self.at(method.stages, r)};"
            yield f"dx{r} = d{self.at(method.stages, r)};"

    def stage(self, stage: int, to: dict[int, float]) -> Iterator[str]:
        """Slopes and their tangents, row by row.

        Args:
            stage: index of the stage.
            to: weights of its slopes, step size included, by later stage.
        """
        n, m = self.n, self.m
        arguments = [*(self.at(stage, r) for r in range(n)), *(f"u{stage}_{k}" for k in range(m))]
        scope = Scope(self.numbers, arguments, f"v{stage}_")
        yield "hoisted = opaque(hoisted), w = opaque(w);"
        for k in range(m):
            first, last = f"__ldg(w + {n + k})", f"__ldg(w + {n + m + k})"
            yield f"const double u{stage}_{k} = fma(fraction{stage}, {last} - {first}, {first});"
            yield f"const Row du{stage}_{k} = control_tangent({n + k}, {n + m + k}, fraction{stage});"
        for r, slope in enumerate(self.numbers.outputs[: self.rows]):
            tangent = f"slope{stage}_{r}"
            yield from scope.make(slope)
            yield f"Row {tangent} = {{}};"
            for column, entry in self.entries[r]:
                yield from scope.make(entry)
                yield f"add({tangent}, {scope.names[entry]}, d{arguments[column]});"
            for target, weight in to.items():
                yield from self.declare(target, r)
                where = self.at(target, r)
                yield f"{where} = fma({literal(weight)}, {scope.names[slope]}, {where});"
                yield f"add(d{where}, {literal(weight)}, {tangent});"

    def at(self, stage: int, row: int) -> str:
        """Variable of a row of the state at a stage."""
        return f"y{stage}_{row}" if (stage, row) in self.declared else f"x{row}"

    def declare(self, stage: int, row: int) -> Iterator[str]:
        """Declarations of a row's variables at a stage, unless there are any."""
        if (stage, row) not in self.declared:
            self.declared.add((stage, row))
            yield f"double {self.at(stage, row)} = x{row};"
            yield f"Row d{self.at(stage, row)} = dx{row};"
