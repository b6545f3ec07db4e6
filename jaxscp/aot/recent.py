"""The last things that were made, by key."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Made = TypeVar("Made")


class Recent(Generic[Made]):
    """Holds the last ones asked for. Each is made once, though many threads ask for it at a time.

    Args:
        most: number that is held.

    Example:
        >>> from jaxscp.aot.recent import Recent
        >>> squares = Recent(2)
        >>> [squares.get(k, lambda k=k: k * k) for k in (1, 2, 3)], squares.known(1), squares.known(3)
        ([1, 4, 9], None, 9)
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._found: OrderedDict[Hashable, Made] = OrderedDict()
        self._making: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()

    def known(self, key: Hashable) -> Made | None:
        """The one of a key, or None."""
        with self._lock:
            if (found := self._found.get(key)) is not None:
                self._found.move_to_end(key)
            return found

    def get(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """The one of a key; made if it is not held."""
        if (found := self.known(key)) is not None:
            return found
        with self._lock:
            making = self._making.setdefault(key, threading.Lock())
        with making:
            if (found := self.known(key)) is None:
                found = make()
                self._hold(key, found)
        return found

    def clear(self) -> None:
        """Drop all."""
        with self._lock:
            self._found.clear()

    def _hold(self, key: Hashable, made: Made) -> None:
        with self._lock:
            self._making.pop(key, None)  # threads that wait for it hold it, and find the result
            self._found[key] = made
            while len(self._found) > self._most:
                self._found.popitem(last=False)
