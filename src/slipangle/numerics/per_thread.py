"""`PerThread`: memory that a solver writes to, one piece for each thread that calls it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cached_property
from typing import Any, Generic, TypeVar

T = TypeVar("T")

_BUILDING = threading.RLock()


class built(cached_property[T]):  # reads as `cached_property` does
    """A cached property such as a solver, which one thread builds while others wait for it."""

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        with _BUILDING:
            return super().__get__(instance, owner)


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


def of_thread(name: str) -> Any:
    """The method of that name of the calling thread's area, for a subclass of `OfThreads`."""

    def call(self: OfThreads, *given: Any) -> Any:
        return getattr(self._areas.mine, name)(*given)

    return call


class OfThreads:
    """An object with a work area for each thread, to which it passes calls on."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self._told: dict[str, tuple[Any, ...]] = {}

        def area() -> Any:
            made = make()
            for name, given in self._told.items():
                getattr(made, name)(*given)
            return made

        self._areas = PerThread(area)
        _ = self._areas.mine

    def _tell(self, name: str, *given: Any) -> None:
        """Call a method of this thread's area, and of all that are made from now on."""
        self._told[name] = given
        getattr(self._areas.mine, name)(*given)
