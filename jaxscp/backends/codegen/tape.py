"""Tapes: scalar operations in order, each with a slot for its result. C++, JAX and CUDA kernels evaluate them.

A slot is used again after the last read of its number, so that slots stay few.
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
Step = tuple[str, Number, tuple[Number, ...]]  # operation, result, operands
CODES = {name: code for code, name in enumerate(ARITHMETIC.split())}  # as in integration's ``native/tape.h``


class Tape(NamedTuple):
    """A straight-line program. Slots hold the inputs first, then parameters, constants and results."""

    operations: np.ndarray
    """(operations, 5): code, slot of the result, slots of up to three operands."""
    hoisted_count: int
    """Number of leading operations that depend on no input."""
    parameters: list[tuple[int, int]]
    """(array, index) of each parameter; see ``tracing``."""
    constants: np.ndarray
    outputs: np.ndarray
    """Slots of the outputs."""
    slots: int


def record(outputs: Sequence[Number], inputs: int) -> Tape:
    """Tape of an expression graph.

    Args:
        outputs: nodes whose values are asked for.
        inputs: number of inputs.
    """
    order, uses = _topological_order(outputs)
    varying = _varying(order)
    order.sort(key=lambda n: n in varying)  # stable
    parameters = [n for n in order if n.kind == "parameter"]
    constants = [n for n in order if n.kind == "constant"]
    slot = {n: n.value for n in order if n.kind == "argument"}
    slot |= {n: inputs + i for i, n in enumerate(parameters + constants)}
    absorbed = _products_to_absorb(order, uses, varying)
    products = set(absorbed.values())
    steps = [_step(n, absorbed.get(n)) for n in order if n.operands and n not in products]
    hoisted_count = sum(n not in varying for _, n, _ in steps)
    steps = _in_runs(steps[:hoisted_count]) + _in_runs(steps[hoisted_count:])
    persistent = {n for n in order if n not in varying or not n.operands} | set(outputs)
    last = {v: i for i, (_, _, operands) in enumerate(steps) for v in operands}
    free: list[int] = []
    top = inputs + len(parameters) + len(constants)
    operations = []
    for i, (kind, number, operands) in enumerate(steps):
        read = [slot[v] for v in operands]
        free += {slot[v] for v in operands if v not in persistent and last[v] == i}
        if i < hoisted_count or not free:
            free.append(top)
            top += 1
        slot[number] = free.pop()
        operations.append([CODES[kind], slot[number], *read, *[0] * (3 - len(read))])
    return Tape(
        np.array(operations, np.int32).reshape(-1, 5),
        hoisted_count,
        [n.value for n in parameters],
        np.array([n.value for n in constants], float),
        np.array([slot[n] for n in outputs], np.int32),
        top,
    )


def _varying(order: Sequence[Number]) -> set[Number]:
    """Nodes that depend on an argument."""
    found: set[Number] = set()
    for n in order:
        if n.kind == "argument" or any(v in found for v in n.operands):
            found.add(n)
    return found


def _topological_order(outputs: Sequence[Number]) -> tuple[list[Number], dict[Number, int]]:
    """Nodes, each after its operands; and the number of reads of each."""
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
    """For each sum or difference, the product that it alone reads: both become one fused operation."""
    found = {}
    for n in order:
        if n.kind in ("sum", "difference"):
            for v in n.operands if n.kind == "sum" else n.operands[1:]:
                if v.kind == "product" and uses[v] == 1 and (v in varying) == (n in varying):
                    found[n] = v
    return found


def _in_runs(steps: list[Step]) -> list[Step]:
    """The same steps, in runs of one operation each: an interpreter then decodes fewer operations."""
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
    """Operation, result and operands of a node; fused with a product if there is one."""
    if product is None:
        return n.kind, n, n.operands
    addend = n.operands[0] if n.operands[1] is product else n.operands[1]
    return ("multiply_add" if n.kind == "sum" else "multiply_subtract"), n, (*product.operands, addend)
