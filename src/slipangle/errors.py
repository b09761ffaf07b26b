"""One exception per kind of bad input; each message says what, got, expected, fix."""

import difflib
import inspect
import re
from collections.abc import Callable, Iterable, Sequence

_LONGEST = 2000  # letters of a message
_ENDLESS = re.compile(r"\S{300,}")


class SlipangleError(ValueError):
    """Base of every error a user can cause; the command line prints it and exits with code 2.

    What a message repeats of a file or a setting is cut to about a line.
    """

    def __init__(self, message: object = "") -> None:
        text = _ENDLESS.sub(lambda run: f"{run[0][:120]}...{run[0][-40:]}", str(message))
        super().__init__(text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}...")


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


class MissingExtraError(ConfigError):
    """Something that an extra of the installation brings, which is not there."""


class HashError(SlipangleError):
    """A data file that is not the published one."""


class WriteError(SlipangleError):
    """A place that cannot be written."""


class SimulationError(SlipangleError):
    """A simulation that left the range of finite numbers."""


class SolverError(SlipangleError):
    """An optimisation that ended without an answer to be trusted."""


class IdentifiabilityWarning(UserWarning):
    """The data do not determine every free parameter; the message names those, docs/troubleshooting.md says why."""


class ModelWarning(UserWarning):
    """A model used near or beyond what it was made for; docs/troubleshooting.md has an entry for each sentence."""


def shown(value: object, most: int = 60) -> str:
    """A value as it is written in Python, cut to at most ``most`` letters, for messages.

    >>> shown("x" * 100, most=20)
    "'xxxxxxxxxxxxxxxx..."
    """
    text = " ".join(repr(value[: most + 1] if isinstance(value, str) else value).split())
    return text if len(text) <= most else f"{text[: most - 3]}..."


def place(function: object) -> str:
    """Where a function is written, for messages: line and file, or what it is."""
    code = getattr(inspect.unwrap(function) if callable(function) else function, "__code__", None)
    return type(function).__name__ if code is None else f"line {code.co_firstlineno} of {code.co_filename}"


def nearest(name: str, known: Iterable[str], *, every: bool = False) -> str:
    """Sentence part that offers the names closest to ``name`` among ``known``, or all that are near if ``every``.

    >>> nearest("v_X", ["v_x", "v_y", "delta"])
    "nearest are 'v_x', 'v_y'"
    """
    names = sorted({str(k)[:80] for k in known})
    if not names:
        return "there are none"
    lower, most = {n.lower(): n for n in names}, len(names) if every else 3
    close = [lower[n] for n in difflib.get_close_matches(name[:80].lower(), list(lower), n=most, cutoff=0.5)]
    if close:
        return "nearest are " + ", ".join(repr(n) for n in close)
    listed = names if every else names[:12]
    return f"there are {', '.join(map(repr, listed))}" + (", ..." if len(names) > len(listed) else "")


def require_known(name: str, known: Sequence[str], what: str) -> None:
    """Raise unless a setting is one of the words it may be.

    Raises ParameterError with those words and the nearest of them.
    """
    if name not in known:
        raise ParameterError(f"the {what} is '{name}'; expected one of {', '.join(known)}: {nearest(name, known)}")


def raises(error: type[Exception], call: Callable[[str], object], text: str) -> bool:
    """Whether ``call(text)`` raises this error."""
    try:
        call(text)
    except error:
        return True
    return False
