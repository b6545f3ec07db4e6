"""Operations on numbers, in order and with a place for each: what the compiled sweep runs.

Places are used again as soon as what is in them has been read for the last time, so that they stay few.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxscp.sweeps.symbols import Number

ARITHMETIC = """
sum difference product reciprocal negative choice multiply_add multiply_subtract
sqrt sin cos exp log tanh max min abs lt le gt ge eq
"""
CODES = {name: code for code, name in enumerate(ARITHMETIC.split())}  # as in ``native/tape.h``


class Tape(NamedTuple):
    """A program for numbers: arguments come first among the places, then parameters, then constants."""

    operations: np.ndarray
    """(operations, 5): code, place of the result, places of up to three operands."""
    once: int
    """How many of the operations, the first, depend on no argument."""
    parameters: list[tuple[int, int]]
    """Which they are."""
    constants: np.ndarray
    outputs: np.ndarray
    """Places of the results."""
    places: int


def record(outputs: Sequence[Number], arguments: int) -> Tape:
    """Put what leads to these numbers in order."""
    order, uses = _order(outputs)
    varying = _varying(order)
    order.sort(key=lambda n: id(n) in varying)  # keeps the order of the others
    parameters = [n for n in order if n.kind == "parameter"]
    constants = [n for n in order if n.kind == "constant"]
    place = {id(n): n.value for n in order if n.kind == "argument"}
    place |= {id(n): arguments + i for i, n in enumerate(parameters + constants)}
    absorbed = _products_to_absorb(order, uses, varying)
    inside = {id(product) for product in absorbed.values()}
    steps = [_step(n, absorbed.get(id(n))) for n in order if n.operands and id(n) not in inside]
    once = sum(id(n) not in varying for _, n, _ in steps)
    kept = {id(n) for n in order if id(n) not in varying or not n.operands} | set(map(id, outputs))
    last = {id(v): i for i, (_, _, operands) in enumerate(steps) for v in operands}
    free: list[int] = []
    top = arguments + len(parameters) + len(constants)
    operations = []
    for i, (kind, number, operands) in enumerate(steps):
        read = [place[id(v)] for v in operands]
        free += {place[id(v)] for v in operands if id(v) not in kept and last[id(v)] == i}
        if i < once or not free:
            free.append(top)
            top += 1
        place[id(number)] = free.pop()
        operations.append([CODES[kind], place[id(number)], *read, *[0] * (3 - len(read))])
    return Tape(
        np.array(operations, np.int32).reshape(-1, 5),
        once,
        [n.value for n in parameters],
        np.array([n.value for n in constants], float),
        np.array([place[id(n)] for n in outputs], np.int32),
        top,
    )


def _varying(order: Sequence[Number]) -> set[int]:
    """What depends on an argument."""
    found: set[int] = set()
    for n in order:
        if n.kind == "argument" or any(id(v) in found for v in n.operands):
            found.add(id(n))
    return found


def _order(outputs: Sequence[Number]) -> tuple[list[Number], dict[int, int]]:
    """Every number after those that it is made of, and how often each is read."""
    order: list[Number] = []
    uses: dict[int, int] = {}
    seen: set[int] = set()
    stack = [(n, False) for n in reversed(outputs)]
    for n in outputs:
        uses[id(n)] = uses.get(id(n), 0) + 1
    while stack:
        n, done = stack.pop()
        if done:
            order.append(n)
        elif id(n) not in seen:
            seen.add(id(n))
            stack.append((n, True))
            for v in n.operands:
                uses[id(v)] = uses.get(id(v), 0) + 1
                stack.append((v, False))
    return order, uses


def _products_to_absorb(
    order: Sequence[Number], uses: dict[int, int], varying: set[int]
) -> dict[int, Number]:
    """By sum or difference, the product that it alone reads, which one operation then makes with it."""
    found = {}
    for n in order:
        if n.kind in ("sum", "difference"):
            for v in n.operands if n.kind == "sum" else n.operands[1:]:
                if v.kind == "product" and uses[id(v)] == 1 and (id(v) in varying) == (id(n) in varying):
                    found[id(n)] = v
    return found


def _step(n: Number, product: Number | None) -> tuple[str, Number, tuple[Number, ...]]:
    """The operation that makes a number, and what it reads."""
    if product is None:
        return n.kind, n, n.operands
    rest = n.operands[0] if n.operands[1] is product else n.operands[1]
    return ("multiply_add" if n.kind == "sum" else "multiply_subtract"), n, (*product.operands, rest)
