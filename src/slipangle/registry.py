"""`Registry`: things of one kind by name, open to what others write.

A package adds to it with the decorator `Registry.register`, or, so that nothing needs to be imported first, with an
entry point of its own under the registry's group, such as ``[project.entry-points."slipangle.records"]``.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import entry_points
from typing import Any, TypeVar

from slipangle.errors import ModelWarning, ParameterError, nearest

T = TypeVar("T")
Thing = TypeVar("Thing")


class Registry(Mapping[str, T]):
    """Things of one kind by name.

    Parameters
    ----------
    kind : str
        What one of them is called, in messages.
    group : str
        Entry points under this name are added when something is looked up; see `importlib.metadata`.
    """

    def __init__(self, kind: str, group: str) -> None:
        self.kind, self.group = kind, group
        self._things: dict[str, T] = {}
        self._searched = False

    def register(self, name: str) -> Callable[[Thing], Thing]:
        """A decorator that adds what it stands above.

        Raises ParameterError if something else has this name.
        """

        def add(thing: Thing) -> Thing:
            known = self._things.get(name)
            if known is not None and not _same(known, thing):
                raise ParameterError(f"there is a {self.kind} '{name}' already; expected another name: rename yours")
            self._things[name] = thing  # type: ignore[assignment]  # of the kind that this registry is for
            return thing

        return add

    def _all(self) -> dict[str, T]:
        if not self._searched:
            self._searched = True
            for point in entry_points(group=self.group):
                try:
                    self.register(point.name)(point.load())
                except Exception as error:
                    warnings.warn(
                        f"the {self.kind} '{point.name}' of an installed package cannot be used "
                        f"({type(error).__name__}: {str(error)[:80]}): update that package or remove it",
                        ModelWarning,
                        stacklevel=4,
                    )
        return self._things

    def __getitem__(self, name: str) -> T:
        """The thing of that name.

        Raises ParameterError if there is none; the nearest names are given.
        """
        things = self._all()
        if name not in things:
            raise ParameterError(
                f"there is no {self.kind} '{name}'; {nearest(name, things)}: use one of these, or register your own"
            )
        return things[name]

    def get(self, name: str, default: Any = None) -> Any:
        """The thing of that name, or ``default``."""
        return self._all().get(name, default)

    def __contains__(self, name: object) -> bool:
        return name in self._all()

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())


def _same(a: Any, b: Any) -> bool:
    """Whether two are one, or one defined again by a module that was loaded again."""
    where = [(getattr(x, "__module__", None), getattr(x, "__qualname__", None)) for x in (a, b)]
    return a is b or (where[0] == where[1] and where[0][1] is not None)
