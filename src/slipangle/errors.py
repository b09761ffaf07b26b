"""One exception per kind of bad input; each message says what, got, expected, fix."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


class SlipangleError(ValueError):
    """Base of every error a user can cause; the command line prints it and exits with code 2."""


class MissingFileError(SlipangleError):
    """A file that does not exist or cannot be read."""


class FormatError(SlipangleError):
    """A file whose text or cells are not what its format promises."""


class MissingColumnError(SlipangleError):
    """A column or channel that the data do not have."""


class TimeError(SlipangleError):
    """Time stamps that go backwards, repeat, or mix sample times."""


class SampleTimeError(SlipangleError):
    """Data and model, or data and data, at different sample times."""


class UnitError(SlipangleError):
    """An unknown unit, or one of another quantity."""


class NotFiniteError(SlipangleError):
    """NaN or infinity where a number is needed."""


class ExcitationError(SlipangleError):
    """Data that cannot identify what was asked: constant or collinear inputs."""


class TooShortError(SlipangleError):
    """A record with too few samples."""


class ParameterError(SlipangleError):
    """A parameter outside its range, or a name that does not exist."""


class ConfigError(SlipangleError):
    """A settings file with an unknown or missing entry."""


class HashError(SlipangleError):
    """A data file that is not the published one."""


class OutputError(SlipangleError):
    """A place that cannot be written."""


class SimulationError(SlipangleError):
    """A simulation that left the range of finite numbers."""


class IdentifiabilityWarning(UserWarning):
    """The data do not determine every free parameter; the message names those."""


class ModelWarning(UserWarning):
    """A model used near or beyond what it was made for."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Sentence part that offers the names closest to ``name`` among ``known``.

    >>> nearest("v_X", ["v_x", "v_y", "delta"])
    "nearest are 'v_x', 'v_y'"
    """
    names = sorted(set(known))
    if not names:
        return "there are none"
    lower = {n.lower(): n for n in names}
    close = [lower[n] for n in difflib.get_close_matches(name.lower(), list(lower), n=3, cutoff=0.5)]
    if close:
        return "nearest are " + ", ".join(repr(n) for n in close)
    shown = ", ".join(repr(n) for n in names[:12])
    return f"there are {shown}" + (", ..." if len(names) > 12 else "")


def require_known(name: str, known: Sequence[str], what: str) -> None:
    """Raise unless a setting is one of the words it may be.

    Raises
    ------
    ParameterError
        With those words and the nearest of them.
    """
    if name not in known:
        raise ParameterError(f"the {what} is '{name}'; expected one of {', '.join(known)}: {nearest(name, known)}")
