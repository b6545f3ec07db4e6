"""From a tape to statements of C: what kernels for NVIDIA GPUs are written with.

Operations stand where their results are first needed, so that few numbers are held; and what depends on no argument is
found once a flight, outside of the kernel, and read where it is needed.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from jaxscp.backends.codegen import tape
from jaxscp.backends.codegen.functions import Function

COMPARISONS = """\
// no number stays none, whichever it is
inline double greater(double x, double y) { return x != x ? x : y <= x ? x : y; }
inline double less(double x, double y) { return x != x ? x : y >= x ? x : y; }

"""

_FORMS = {
    "sum": "{} + {}",
    "difference": "{} - {}",
    "product": "{} * {}",
    "reciprocal": "1.0 / {}",
    "negative": "-{}",
    "choice": "{} != 0.0 ? {} : {}",
    "multiply_add": "fma({}, {}, {})",
    "multiply_subtract": "fma(-{}, {}, {})",
    **{name: name + "({})" for name in ("sqrt", "sin", "cos", "exp", "log", "tanh")},
    "max": "greater({}, {})",
    "min": "less({}, {})",
    "abs": "fabs({})",
    "lt": "{} < {} ? 1.0 : 0.0",
    "le": "{} <= {} ? 1.0 : 0.0",
    "gt": "{} > {} ? 1.0 : 0.0",
    "ge": "{} >= {} ? 1.0 : 0.0",
    "eq": "{} == {} ? 1.0 : 0.0",
}
_BY_CODE = {tape.CODES[name]: form for name, form in _FORMS.items()}


def known(function: Function) -> list[int]:
    """Places of what depends on no argument and is no constant, as far as what does depend on one reads it.

    Nothing else is ever put there.
    """
    t, inputs = function.first, _inputs(function)
    of_parameters = range(inputs, inputs + len(t.parameters))
    found = {*of_parameters, *t.operations[: t.hoisted, 1].tolist()}
    read = {place for code, _, *places in t.operations[t.hoisted :].tolist() for place in _read(code, places)}
    return sorted(found & (read | set(t.outputs.tolist())))


def _inputs(function: Function) -> int:
    return function.arguments + function.values  # of which each has a price, which nothing here reads


def _read(code: int, operands: list[int]) -> list[int]:
    """Those that an operation has."""
    return operands[: _BY_CODE[code].count("{}")]


class Numbers(NamedTuple):
    """What depends on arguments, every number with one of its own; what does not has its place's."""

    operations: dict[int, tuple[int, list[int]]]
    """By number: the code of what makes it, and what that reads."""
    outputs: list[int]
    known: dict[int, int]
    """By place: which of ``known`` is there."""
    constants: dict[int, str]
    """By place: the constant that is there."""


def numbered(function: Function) -> Numbers:
    """Those of a function without data, and of its Jacobian."""
    t = function.first
    at = {place: place for place in range(t.places)}  # places serve again
    operations = {}
    for number, (code, to, *places) in enumerate(t.operations[t.hoisted :].tolist(), start=t.places):
        operations[number] = code, [at[v] for v in _read(code, places)]
        at[to] = number
    places = {place: i for i, place in enumerate(known(function))}
    constants = enumerate(t.constants.tolist(), start=_inputs(function) + len(t.parameters))
    spelled = {place: literal(value) for place, value in constants}
    return Numbers(operations, [at[v] for v in t.outputs.tolist()], places, spelled)


class Scope:
    """Names of numbers. One without is read or made when it is needed, after what it is made of."""

    def __init__(self, numbers: Numbers, arguments: Sequence[str], prefix: str) -> None:
        self.numbers, self.prefix = numbers, prefix
        self.names = numbers.constants | dict(enumerate(arguments))

    def make(self, number: int) -> Iterator[str]:
        """Statements after which it has a name."""
        waiting = [number]
        while waiting:
            last = waiting[-1]
            _, read = self.numbers.operations.get(last, (0, []))
            lacking = [v for v in (last, *read) if v not in self.names]
            if last not in lacking:
                waiting.pop()
            elif len(lacking) > 1:
                waiting += reversed(lacking[1:])
            else:
                value = self.value(last)
                self.names[last] = f"{self.prefix}{last}"
                yield f"const double {self.names[last]} = {value};"

    def value(self, number: int) -> str:
        """It, by what has a name."""
        if number in self.numbers.known:
            return f"__ldg(known + {self.numbers.known[number]})"
        code, read = self.numbers.operations[number]
        return _BY_CODE[code].format(*(self.names[v] for v in read))


def literal(value: float) -> str:
    """A number as it is written."""
    if math.isfinite(value):
        return repr(value) if math.copysign(1.0, value) > 0.0 else f"({value!r})"
    return "(0.0 / 0.0)" if math.isnan(value) else f"({'-' if value < 0.0 else ''}1.0 / 0.0)"


def filled(text: str, numbers: dict[str, int]) -> str:
    """A text in which numbers take the place of their names, of which each has @ before it."""
    for name, number in numbers.items():
        text = text.replace(f"@{name}", str(number))
    return text
