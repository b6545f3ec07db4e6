"""CUDA statements of a tape.

An operation stands just before its first use, so that few numbers are live. Hoisted constants, which depend on no
argument, are computed once outside of the kernel and read from memory.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from jaxscp.backends.codegen import tape

COMPARISONS = """\
// NaN if either operand is NaN
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


def hoisted_slots(t: tape.Tape, inputs: int) -> list[int]:
    """Slots of parameters and hoisted results that the outputs, or operations on inputs, read.

    Such a slot holds the same number throughout the tape.

    Args:
        t: the tape.
        inputs: number of its inputs.
    """
    of_parameters = range(inputs, inputs + len(t.parameters))
    found = {*of_parameters, *t.operations[: t.hoisted_count, 1].tolist()}
    varying = t.operations[t.hoisted_count :].tolist()
    read = {slot for code, _, *slots in varying for slot in _operands(code, slots)}
    return sorted(found & (read | set(t.outputs.tolist())))


def _operands(code: int, slots: list[int]) -> list[int]:
    """The slots that an operation reads: as many as it has operands."""
    return slots[: _BY_CODE[code].count("{}")]


class Numbers(NamedTuple):
    """A tape in static single assignment: every result that depends on an input has a number of its own.

    All other numbers keep the index of their slot.
    """

    operations: dict[int, tuple[int, list[int]]]
    """By number: code of the operation, and its operands."""
    outputs: list[int]
    hoisted: dict[int, int]
    """By slot: index among the hoisted constants."""
    constants: dict[int, str]
    """By slot: a literal."""


def numbered(t: tape.Tape, inputs: int) -> Numbers:
    """Static single assignment of a tape.

    Args:
        t: the tape.
        inputs: number of its inputs.
    """
    at = {slot: slot for slot in range(t.slots)}  # latest number in each slot
    operations = {}
    for number, (code, to, *slots) in enumerate(t.operations[t.hoisted_count :].tolist(), start=t.slots):
        operations[number] = code, [at[v] for v in _operands(code, slots)]
        at[to] = number
    hoisted = {slot: i for i, slot in enumerate(hoisted_slots(t, inputs))}
    constants = enumerate(t.constants.tolist(), start=inputs + len(t.parameters))
    literals = {slot: literal(value) for slot, value in constants}
    return Numbers(operations, [at[v] for v in t.outputs.tolist()], hoisted, literals)


class Scope:
    """Variables of a C++ scope: a number is declared when it is first needed, after its operands."""

    def __init__(self, numbers: Numbers, arguments: Sequence[str], prefix: str) -> None:
        self.numbers, self.prefix = numbers, prefix
        self.names = numbers.constants | dict(enumerate(arguments))

    def make(self, number: int) -> Iterator[str]:
        """Statements that declare a number and all that it depends on."""
        waiting = [number]
        while waiting:
            last = waiting[-1]
            _, read = self.numbers.operations.get(last, (0, []))
            undeclared = [v for v in (last, *read) if v not in self.names]
            if last not in undeclared:
                waiting.pop()
            elif len(undeclared) > 1:
                waiting += reversed(undeclared[1:])
            else:
                value = self.value(last)
                self.names[last] = f"{self.prefix}{last}"
                yield f"const double {self.names[last]} = {value};"

    def value(self, number: int) -> str:
        """Expression of a number whose operands are declared."""
        if number in self.numbers.hoisted:
            return f"__ldg(hoisted + {self.numbers.hoisted[number]})"
        code, read = self.numbers.operations[number]
        return _BY_CODE[code].format(*(self.names[v] for v in read))


def literal(value: float) -> str:
    """C++ literal of a number."""
    if math.isfinite(value):
        return repr(value) if math.copysign(1.0, value) > 0.0 else f"({value!r})"
    return "(0.0 / 0.0)" if math.isnan(value) else f"({'-' if value < 0.0 else ''}1.0 / 0.0)"


def filled(text: str, numbers: dict[str, int]) -> str:
    """Text in which numbers replace their names, each of which has @ before it."""
    for name, number in numbers.items():
        text = text.replace(f"@{name}", str(number))
    return text
