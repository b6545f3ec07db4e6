"""Arithmetic on numbers that are not known yet: a graph of operations in which each number is there once.

Zeros and ones vanish, and what is equal is the same node, so that the structure of a sparse derivative shows.
"""

from collections.abc import Callable
from typing import Any


class Number:
    """An operation on other numbers; or a constant, an argument, a parameter, which have none."""

    __slots__ = ("index", "kind", "operands", "value")

    def __init__(self, index: int, kind: str, value: Any, operands: tuple["Number", ...]) -> None:
        self.index = index
        """Of its coming into being, so that what is sorted is the same in every run."""
        self.kind = kind
        self.value = value
        """Of a constant; the index of an argument, the array and index of a parameter."""
        self.operands = operands

    @property
    def known(self) -> float | None:
        """Its value, if it has one by itself."""
        return self.value if self.kind == "constant" else None


class Graph:
    """Numbers, each there once.

    Example:
        >>> from jaxscp.backends.codegen.graph import Graph
        >>> g = Graph()
        >>> x, zero = g.leaf("argument", 0), g.leaf("constant", 0.0)
        >>> g.sum(x, g.product(zero, x)) is x
        True
    """

    def __init__(self) -> None:
        self._numbers: dict[tuple, Number] = {}

    def leaf(self, kind: str, value: Any) -> Number:
        """A constant of this value, or the argument or parameter of this place."""
        return self._get(kind, (), value)

    def sum(self, a: Number, b: Number) -> Number:
        """a + b."""
        if a.known is not None and b.known is not None:
            return self._constant(a.known + b.known)
        for one, other in ((a, b), (b, a)):
            if one.known == 0.0:
                return other
            if one.kind == "negative":
                return self.difference(other, one.operands[0])
        return self._get("sum", _sorted(a, b))

    def difference(self, a: Number, b: Number) -> Number:
        """a - b."""
        if a.known is not None and b.known is not None:
            return self._constant(a.known - b.known)
        if a.known == 0.0:
            return self.negative(b)
        if b.known == 0.0:
            return a
        if b.kind == "negative":
            return self.sum(a, b.operands[0])
        return self._get("difference", (a, b))

    def product(self, a: Number, b: Number) -> Number:
        """a b; nothing where either is known to be zero, whatever the other."""
        if a.known is not None and b.known is not None:
            return self._constant(a.known * b.known)
        for one, other in ((a, b), (b, a)):
            if one.known == 0.0:
                return one
            if one.known == 1.0:
                return other
            if one.known == -1.0:
                return self.negative(other)
            if one.kind == "negative":
                return self.negative(self.product(one.operands[0], other))
        return self._get("product", _sorted(a, b))

    def quotient(self, a: Number, b: Number) -> Number:
        """a / b, as a times the reciprocal of b: many are divided by the same."""
        if b.known:
            return self.product(a, self._constant(1.0 / b.known))
        return a if a.known == 0.0 else self.product(a, self._get("reciprocal", (b,)))

    def negative(self, a: Number) -> Number:
        """-a."""
        if a.known is not None:
            return self._constant(-a.known)
        return a.operands[0] if a.kind == "negative" else self._get("negative", (a,))

    def choice(self, which: Number, no: Number, yes: Number) -> Number:
        """``yes`` where ``which`` is not zero, else ``no``."""
        if which.known is not None:
            return yes if which.known else no
        return yes if yes is no else self._get("choice", (which, yes, no))

    def other(self, kind: str, function: Callable[..., float], *operands: Number) -> Number:
        """An operation that nothing simplifies but that its operands are known."""
        values = [v.known for v in operands]
        known = [v for v in values if v is not None]
        return (
            self._constant(function(*known))
            if len(known) == len(values)
            else self._get(kind, tuple(operands))
        )

    def _constant(self, value: float) -> Number:
        return self.leaf("constant", value)

    def _get(self, kind: str, operands: tuple[Number, ...], value: Any = None) -> Number:
        key = (kind, value, *(v.index for v in operands))
        found = self._numbers.get(key)
        if found is None:
            found = self._numbers[key] = Number(len(self._numbers), kind, value, operands)
        return found


def _sorted(a: Number, b: Number) -> tuple[Number, Number]:
    return (a, b) if a.index < b.index else (b, a)
