"""`PerThread`: memory that a solver writes to, one piece for each thread that calls it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

BUILDING = threading.RLock()  # one thread builds a solver, others wait for it


class PerThread(Generic[T]):
    """Makes a work area for each thread that asks for one; it is freed when the thread ends.

    >>> areas = PerThread(list)
    >>> areas.mine is areas.mine
    True
    """

    def __init__(self, make: Callable[[], T]) -> None:
        self._make, self._local = make, threading.local()

    @property
    def mine(self) -> T:
        """The calling thread's area."""
        try:
            return self._local.area
        except AttributeError:
            self._local.area = made = self._make()
            return made
