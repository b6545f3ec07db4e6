"""Expression graph of scalar arithmetic, simplified while it is built.

Zeros and ones vanish, and equal expressions are one node, so that the sparsity of a derivative shows.
"""

from collections.abc import Callable
from typing import Any


class Number:
    """A node: an operation on other nodes; or a constant, an argument or a parameter, which have no operands."""

    __slots__ = ("index", "kind", "operands", "value")

    def __init__(self, index: int, kind: str, value: Any, operands: tuple["Number", ...]) -> None:
        self.index = index
        """Order of creation; sorting by it makes every run the same."""
        self.kind = kind
        self.value = value
        """Value of a constant; index of an argument; (array, index) of a parameter."""
        self.operands = operands

    @property
    def constant(self) -> float | None:
        """Value of a constant; None for every other node."""
        return self.value if self.kind == "constant" else None


class Graph:
    """Expression graph, each node of which is unique.

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
        """Constant of this value; or argument or parameter of this index."""
        return self._get(kind, (), value)

    def sum(self, a: Number, b: Number) -> Number:
        """a + b."""
        if a.constant is not None and b.constant is not None:
            return self._constant(a.constant + b.constant)
        if a.kind == b.kind == "negative":
            return self.negative(self.sum(a.operands[0], b.operands[0]))
        for one, other in ((a, b), (b, a)):
            if one.constant == 0.0:
                return other
            if one.kind == "negative":
                return self.difference(other, one.operands[0])
        return self._get("sum", _sorted(a, b))

    def difference(self, a: Number, b: Number) -> Number:
        """a - b."""
        if a.constant is not None and b.constant is not None:
            return self._constant(a.constant - b.constant)
        if a.constant == 0.0:
            return self.negative(b)
        if b.constant == 0.0:
            return a
        if b.kind == "negative":
            return self.sum(a, b.operands[0])
        return self._get("difference", (a, b))

    def product(self, a: Number, b: Number) -> Number:
        """a b; zero if either is the constant zero, even if the other may be NaN."""
        if a.constant is not None and b.constant is not None:
            return self._constant(a.constant * b.constant)
        for one, other in ((a, b), (b, a)):
            if one.constant == 0.0:
                return one
            if one.constant == 1.0:
                return other
            if one.constant == -1.0:
                return self.negative(other)
            if one.kind == "negative":
                return self.negative(self.product(one.operands[0], other))
        return self._get("product", _sorted(a, b))

    def quotient(self, a: Number, b: Number) -> Number:
        """a / b, as a times 1 / b: many quotients share a divisor."""
        if b.constant:
            return self.product(a, self._constant(1.0 / b.constant))
        return a if a.constant == 0.0 else self.product(a, self._get("reciprocal", (b,)))

    def negative(self, a: Number) -> Number:
        """-a."""
        if a.constant is not None:
            return self._constant(-a.constant)
        return a.operands[0] if a.kind == "negative" else self._get("negative", (a,))

    def choice(self, which: Number, no: Number, yes: Number) -> Number:
        """``yes`` where ``which`` is not zero, else ``no``."""
        if which.constant is not None:
            return yes if which.constant else no
        return yes if yes is no else self._get("choice", (which, yes, no))

    def other(self, kind: str, function: Callable[..., float], *operands: Number) -> Number:
        """An operation whose only simplification is the folding of constants."""
        values = [v.constant for v in operands]
        constants = [v for v in values if v is not None]
        return (
            self._constant(function(*constants))
            if len(constants) == len(values)
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
