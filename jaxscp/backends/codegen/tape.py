"""Operations on numbers, in order and with a place for each: what the compiled sweep runs.

Places are used again as soon as what is in them has been read for the last time, so that they stay few.
"""

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxscp.backends.codegen.graph import Number

ARITHMETIC = """
sum difference product reciprocal negative choice multiply_add multiply_subtract
sqrt sin cos exp log tanh max min abs lt le gt ge eq
"""
Step = tuple[str, Number, tuple[Number, ...]]  # what is done, what it makes, and from what
CODES = {name: code for code, name in enumerate(ARITHMETIC.split())}  # as in ``native/tape.h``


class Tape(NamedTuple):
    """A program for numbers: arguments come first among the places, then parameters, then constants."""

    operations: np.ndarray
    """(operations, 5): code, place of the result, places of up to three operands."""
    hoisted: int
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
    order.sort(key=lambda n: n in varying)  # keeps the order of the others
    parameters = [n for n in order if n.kind == "parameter"]
    constants = [n for n in order if n.kind == "constant"]
    place = {n: n.value for n in order if n.kind == "argument"}
    place |= {n: arguments + i for i, n in enumerate(parameters + constants)}
    absorbed = _products_to_absorb(order, uses, varying)
    inside = set(absorbed.values())
    steps = [_step(n, absorbed.get(n)) for n in order if n.operands and n not in inside]
    hoisted = sum(n not in varying for _, n, _ in steps)
    steps = _in_runs(steps[:hoisted]) + _in_runs(steps[hoisted:])
    kept = {n for n in order if n not in varying or not n.operands} | set(outputs)
    last = {v: i for i, (_, _, operands) in enumerate(steps) for v in operands}
    free: list[int] = []
    top = arguments + len(parameters) + len(constants)
    operations = []
    for i, (kind, number, operands) in enumerate(steps):
        read = [place[v] for v in operands]
        free += {place[v] for v in operands if v not in kept and last[v] == i}
        if i < hoisted or not free:
            free.append(top)
            top += 1
        place[number] = free.pop()
        operations.append([CODES[kind], place[number], *read, *[0] * (3 - len(read))])
    return Tape(
        np.array(operations, np.int32).reshape(-1, 5),
        hoisted,
        [n.value for n in parameters],
        np.array([n.value for n in constants], float),
        np.array([place[n] for n in outputs], np.int32),
        top,
    )


def _varying(order: Sequence[Number]) -> set[Number]:
    """What depends on an argument."""
    found: set[Number] = set()
    for n in order:
        if n.kind == "argument" or any(v in found for v in n.operands):
            found.add(n)
    return found


def _order(outputs: Sequence[Number]) -> tuple[list[Number], dict[Number, int]]:
    """Every number after those that it is made of, and how often each is read."""
    order: list[Number] = []
    uses: dict[Number, int] = {}
    seen: set[Number] = set()
    stack = [(n, False) for n in reversed(outputs)]
    for n in outputs:
        uses[n] = uses.get(n, 0) + 1
    while stack:
        n, done = stack.pop()
        if done:
            order.append(n)
        elif n not in seen:
            seen.add(n)
            stack.append((n, True))
            for v in n.operands:
                uses[v] = uses.get(v, 0) + 1
                stack.append((v, False))
    return order, uses


def _products_to_absorb(
    order: Sequence[Number], uses: dict[Number, int], varying: set[Number]
) -> dict[Number, Number]:
    """By sum or difference, the product that it alone reads, which one operation then makes with it."""
    found = {}
    for n in order:
        if n.kind in ("sum", "difference"):
            for v in n.operands if n.kind == "sum" else n.operands[1:]:
                if v.kind == "product" and uses[v] == 1 and (v in varying) == (n in varying):
                    found[n] = v
    return found


def _in_runs(steps: list[Step]) -> list[Step]:
    """The same, put so that many of one kind follow each other: what is to be done is then looked up less often."""
    waiting = {n: 0 for _, n, _ in steps}
    readers: dict[Number, list[int]] = {n: [] for n in waiting}
    for i, (_, n, operands) in enumerate(steps):
        for v in {v for v in operands if v in waiting}:
            waiting[n] += 1
            readers[v].append(i)
    ready: dict[str, list[int]] = {kind: [] for kind, *_ in steps}
    for i, (kind, n, _) in enumerate(steps):
        if waiting[n] == 0:
            heapq.heappush(ready[kind], i)
    found: list[Step] = []
    while any(ready.values()):
        run = ready[max(ready, key=lambda kind: len(ready[kind]))]
        while run:
            found.append(steps[heapq.heappop(run)])
            for i in readers[found[-1][1]]:
                kind, n, _ = steps[i]
                waiting[n] -= 1
                if waiting[n] == 0:
                    heapq.heappush(ready[kind], i)
    return found


def _step(n: Number, product: Number | None) -> Step:
    """The operation that makes a number, and what it reads."""
    if product is None:
        return n.kind, n, n.operands
    rest = n.operands[0] if n.operands[1] is product else n.operands[1]
    return ("multiply_add" if n.kind == "sum" else "multiply_subtract"), n, (*product.operands, rest)
