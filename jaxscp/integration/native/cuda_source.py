"""The pass through intervals as the text of one CUDA kernel, made from the tape of the slopes.

A thread carries some columns of an interval's tangent through all steps, and flies the path itself: what the threads of
an interval have in common each of them finds anew, and none waits for another. The formulas are those of
``played.linear``.

A GPU has registers for half of what there is, so that few numbers are held. What a slope adds to stages and to the
step's end is added as soon as it is found; operations stand where their results are first needed; and what depends on
no argument is found once a flight, outside of the kernel, and read anew at every stage, as are the controls.
"""

from collections.abc import Iterator

from jaxscp.backends.codegen.cuda_text import COMPARISONS, Scope, filled, literal, numbered
from jaxscp.backends.codegen.functions import Function
from jaxscp.integration.tableaus import Method

THREADS = 128  # of a block

_BEGIN = """\
constexpr int kColumns = @columns, kGroups = @groups, kInputs = @inputs, kRows = @rows, kKnown = @known;

// A row of the tangent, of this thread's columns.
struct Row {
  double at[kColumns];
};

// to += factor * row
inline void add(Row& to, double factor, const Row& row) {
#pragma unroll
  for (int c = 0; c < kColumns; ++c) to.at[c] = fma(factor, row.at[c], to.at[c]);
}

// The same address, which the compiler must not recognise: it would keep all that is read there in registers.
inline const double* anew(const double* from) {
#ifdef __CUDACC__
  asm volatile("" : "+l"(from));
#endif
  return from;
}

// ``intervals`` of a flight share what is known of it; there are ``count`` in all.
extern "C" __global__ void __launch_bounds__(@threads)
    jaxscp_kernel(const double* __restrict__ w, const double* __restrict__ known, double* __restrict__ outcomes,
                  double* __restrict__ jacobian, long long count, long long intervals) {
  const long long thread = static_cast<long long>(blockIdx.x) * @threads + threadIdx.x;
  const long long interval = thread / kGroups;
  if (interval >= count) return;
  const int group = static_cast<int>(thread - interval * kGroups);
  w += interval * kInputs;
  known += interval / intervals * kKnown;

  // of the tangent at the interval's begin: of a state, and of a control at a share of the interval
  auto own = [&](int input) {
    Row row;
#pragma unroll
    for (int c = 0; c < kColumns; ++c) row.at[c] = group + c * kGroups == input ? 1.0 : 0.0;
    return row;
  };
  auto pulled = [&](int first, int last, double share) {
    Row row;
#pragma unroll
    for (int c = 0; c < kColumns; ++c) {
      const int column = group + c * kGroups;
      row.at[c] = column == first ? 1.0 - share : column == last ? share : 0.0;
    }
    return row;
  };
"""

_END = """\
  auto write = [&](int row, double value, const Row& tangent) {
    if (group == 0) outcomes[interval * kRows + row] = value;
#pragma unroll
    for (int c = 0; c < kColumns; ++c) {
      const int column = group + c * kGroups;
      if (column < kInputs) jacobian[(interval * kRows + row) * kInputs + column] = tangent.at[c];
    }
  };"""


def groups(inputs: int, columns: int) -> int:
    """Threads of an interval that has so many inputs, each with so many columns at most."""
    return -(-inputs // columns)


def kernel(slopes: Function, states: int, method: Method, steps: int, columns: int) -> str:
    """The kernel's text.

    Args:
        slopes: of the states and the cost, by states and controls; without data.
        states: how many.
        method: of integration.
        steps: of an interval.
        columns: of the tangent, that a thread carries.
    """
    return "\n".join(_Kernel(slopes, states, method, steps).lines(columns)) + "\n"


class _Kernel:
    """What the text is made of."""

    def __init__(self, slopes: Function, states: int, method: Method, steps: int) -> None:
        self.slopes, self.n, self.method, self.steps = slopes, states, method, steps
        self.m, self.rows = slopes.arguments - states, slopes.values
        self.inputs = states + 2 * self.m
        self.numbers = numbered(slopes)
        self.entries: list[list[tuple[int, int]]] = [[] for _ in range(self.rows)]
        """By row of the Jacobian: column, and number."""
        entries = zip(slopes.jacobian.tolist(), self.numbers.outputs[self.rows :], strict=True)
        for (row, column), number in entries:
            self.entries[row].append((column, number))
        self.begun: set[tuple[int, int]] = set()
        """Stages, of which the end is the last, and rows, where something was added to the step's begin."""

    def lines(self, columns: int) -> Iterator[str]:
        """All of it."""
        n = self.n
        numbers = {"columns": columns, "groups": groups(self.inputs, columns), "inputs": self.inputs}
        numbers |= {"rows": self.rows, "known": len(self.numbers.known), "threads": THREADS}
        yield filled(COMPARISONS + _BEGIN, numbers)
        for r in range(self.rows):
            yield f"  double x{r} = {f'w[{r}]' if r < n else '0.0'};"
            yield f"  Row dx{r} = {f'own({r})' if r < n else '{}'};"
        yield "#pragma unroll 1"
        yield f"  for (int step = 0; step < {self.steps}; ++step) {{"
        yield from (f"    {line}" for line in self.step())
        yield "  }"
        yield _END
        for r in range(self.rows):
            yield f"  write({r}, x{r}, dx{r});"
        yield "}"

    def step(self) -> Iterator[str]:
        """Stage after stage, each with what its slopes are weighed by in those after it and in the end."""
        method, size = self.method, 1.0 / self.steps
        weights = [*method.table.tolist(), method.weights.tolist()]
        for stage, share in enumerate(method.shares.tolist()):
            yield f"const double share{stage} = {literal(size)} * (step + {literal(share)});"
            later = range(stage + 1, method.stages + 1)
            to = {target: size * weights[target][stage] for target in later if weights[target][stage]}
            yield from self.stage(stage, to)
        for r in range(self.rows):
            yield f"x{r} = {self.at(method.stages, r)};"
            yield f"dx{r} = d{self.at(method.stages, r)};"

    def stage(self, stage: int, to: dict[int, float]) -> Iterator[str]:
        """The slopes and their tangents, row by row."""
        n, m = self.n, self.m
        arguments = [*(self.at(stage, r) for r in range(n)), *(f"u{stage}_{k}" for k in range(m))]
        scope = Scope(self.numbers, arguments, f"v{stage}_")
        yield "known = anew(known), w = anew(w);"
        for k in range(m):
            first, last = f"__ldg(w + {n + k})", f"__ldg(w + {n + m + k})"
            yield f"const double u{stage}_{k} = fma(share{stage}, {last} - {first}, {first});"
            yield f"const Row du{stage}_{k} = pulled({n + k}, {n + m + k}, share{stage});"
        for r, slope in enumerate(self.numbers.outputs[: self.rows]):
            tangent = f"slope{stage}_{r}"
            yield from scope.make(slope)
            yield f"Row {tangent} = {{}};"
            for column, entry in self.entries[r]:
                yield from scope.make(entry)
                yield f"add({tangent}, {scope.names[entry]}, d{arguments[column]});"
            for target, weight in to.items():
                yield from self.begin(target, r)
                where = self.at(target, r)
                yield f"{where} = fma({literal(weight)}, {scope.names[slope]}, {where});"
                yield f"add(d{where}, {literal(weight)}, {tangent});"

    def at(self, stage: int, row: int) -> str:
        """A row of the state there."""
        return f"y{stage}_{row}" if (stage, row) in self.begun else f"x{row}"

    def begin(self, stage: int, row: int) -> Iterator[str]:
        """Have a row of its own there."""
        if (stage, row) not in self.begun:
            self.begun.add((stage, row))
            yield f"double {self.at(stage, row)} = x{row};"
            yield f"Row d{self.at(stage, row)} = dx{row};"
