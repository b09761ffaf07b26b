"""What a job is: a TOML file read into frozen records, every entry checked."""

from __future__ import annotations

import tomllib
import types
import typing
from dataclasses import MISSING, dataclass, field, fields
from itertools import pairwise
from math import isfinite
from os.path import normpath, sep
from pathlib import Path, PurePath, PureWindowsPath
from typing import Annotated, Any, Literal, TypeVar

from slipangle.errors import ConfigError, MissingFileError, nearest, shown

T = TypeVar("T")
_LARGEST = 10**15  # of the whole numbers in a job
_MANY, _WIDE = 64, 1000  # entries that a list and a table of a job may have
_WEIGHTS = 1_000_000  # of a network


@dataclass(frozen=True)
class Within:
    """Range of a number, ends included, and its unit; for a list or a table, of each entry."""

    low: float
    high: float
    unit: str = ""


Lags = Annotated[int, Within(0, 1000, "samples")]
Seed = Annotated[int, Within(0, 2**32 - 1)]
Weight = Annotated[float, Within(0, 1e12)]


@dataclass(frozen=True, kw_only=True)
class ColumnSettings:
    """Where a channel is in the file and in which unit."""

    column: str
    unit: str = ""


@dataclass(frozen=True, kw_only=True)
class DataSettings:
    """The log: a file with named columns, or a public data set."""

    file: str = ""
    set: str = ""
    columns: dict[str, ColumnSettings] = field(default_factory=dict)
    time: ColumnSettings | None = None
    dt: Annotated[float, Within(1e-6, 1e4, "s")] | None = None
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    rate: Annotated[float, Within(1e-4, 1e5, "Hz")] | None = None
    cutoff: Annotated[float, Within(1e-5, 1e5, "Hz")] | None = None
    despike: tuple[str, ...] = ()
    hold: Literal["sample", "mean"] = "sample"
    nan: Literal["error", "gap"] = "error"
    train: Annotated[float, Within(0.01, 0.99)] = 0.7


@dataclass(frozen=True, kw_only=True)
class PublishedSettings:
    """Somebody else's numbers on the same car, shown beside ours."""

    source: str
    fit: float | None = None
    vaf: float | None = None
    rmse: float | None = None


@dataclass(frozen=True, kw_only=True)
class ModelSettings:
    """One model to identify: physics, or lags, polynomials, states or a network."""

    name: str
    kind: Literal[
        "bicycle",
        "nonlinear-bicycle",
        "longitudinal",
        "arx",
        "armax",
        "output-error",
        "box-jenkins",
        "state-space",
        "narx",
    ]
    car: dict[str, float] = field(default_factory=dict)
    catalogue: str = ""
    free: tuple[str, ...] = ()
    na: Lags = 2
    nb: Lags = 2
    nk: Lags = 1
    nc: Lags = 1
    nd: Lags = 1
    nf: Lags = 2
    order: tuple[Annotated[int, Within(1, 50)], ...] = ()
    focus: Literal["prediction", "simulation"] = "prediction"
    offset: bool = True
    hidden: tuple[Annotated[int, Within(1, 1000)], ...] = (30, 30)
    seeds: tuple[Seed, ...] = (0,)
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    published: PublishedSettings | None = None


@dataclass(frozen=True, kw_only=True)
class PlantSettings:
    """The car that the controller drives in simulation."""

    catalogue: str = ""
    friction: Annotated[float, Within(0.01, 10)] = 1.0
    noise: dict[str, Weight] = field(default_factory=dict)
    seed: Seed = 0


@dataclass(frozen=True, kw_only=True)
class ControllerSettings:
    """The predictive controller and its test."""

    model: str
    manoeuvre: Literal["iso3888-1", "iso3888-2", "lane-changes"] = "iso3888-1"
    solver: Literal["ipopt", "realtime"] = "ipopt"
    v_x: Annotated[float, Within(1, 150, "m/s")] = 20.0
    dt: Annotated[float, Within(1e-3, 1, "s")] = 0.05
    horizon: Annotated[int, Within(1, 200, "steps")] = 20
    steps: tuple[Annotated[int, Within(1, 1000)], ...] = ()
    width: Annotated[float, Within(0.5, 10, "m")] = 1.8
    Q: dict[str, Weight] = field(default_factory=lambda: {"X": 0.1, "Y": 1.0, "psi": 1.0})
    S: dict[str, Weight] = field(default_factory=lambda: {"delta": 50.0})
    delta_max: Annotated[float, Within(0.1, 90, "deg")] = 20.0
    delta_rate_max: Annotated[float, Within(0.1, 1e4, "deg/s")] = 60.0


@dataclass(frozen=True, kw_only=True)
class Settings:
    """A job.

    Parameters
    ----------
    title : str
        Heading of the page.
    subtitle : str
        A line under it.
    data, model, controller, plant
        The tables of the file; ``model`` is a list. Without a controller the job ends with the verdict.
    out : str
        Folder for the results, below the one that the job is run in; only the command line may name another.
    folder : Path
        Where the settings file is; the log's file name is relative to it.
    """

    title: str
    data: DataSettings
    model: tuple[ModelSettings, ...]
    subtitle: str = ""
    controller: ControllerSettings | None = None
    plant: PlantSettings = field(default_factory=PlantSettings)
    out: str = "slipangle-out"
    folder: Path = field(default=Path(), repr=False)


def read_settings(path: str | Path) -> Settings:
    """Read a job's TOML file.

    Raises
    ------
    MissingFileError
        If the file does not exist.
    ConfigError
        If an entry is unknown, missing or of the wrong type; the nearest names are given.
    """
    file = Path(path)
    try:
        text = file.read_bytes().decode("utf-8")
    except OSError as error:
        raise MissingFileError(
            f"the settings file '{file}' cannot be read ({error.strerror or error}); expected a TOML file: see "
            "examples/ferrari_250lm.toml"
        ) from None
    except UnicodeDecodeError:
        raise ConfigError(f"'{file}' is not text; expected a TOML file in UTF-8: see examples/") from None
    try:
        table = tomllib.loads(text)
    except RecursionError:
        raise ConfigError(f"'{file}' is nested too deeply; expected the entries of a job: see examples/") from None
    except ValueError as error:  # of TOML, or a number of thousands of digits
        raise ConfigError(
            f"'{file}' is not valid TOML: {str(error)[:200]}; expected key = value lines: correct that line"
        ) from None
    settings = _record(Settings, {**table, "folder": file.parent}, file.name)
    _check(settings, file.name)
    return settings


def _check(settings: Settings, where: str) -> None:
    if bool(settings.data.file) == bool(settings.data.set):
        raise ConfigError(
            f"{where}: [data] names {'both a file and a set' if settings.data.file else 'no log'}; expected either "
            'file = "log.csv" or set = "ferrari-250lm"'
        )
    if not settings.model:
        raise ConfigError(f"{where} has no [[model]]; expected at least one: add [[model]] with name and kind")
    names = [m.name for m in settings.model]
    if not all(n.strip() for n in names):
        raise ConfigError(f"{where}: a model's name is empty; expected a few letters: give it one")
    if len(set(names)) < len(names):
        again = next(n for n in names if names.count(n) > 1)
        raise ConfigError(f"{where}: model names repeat: {shown(again)}; expected each once: rename one")
    for m in settings.model:
        weights = sum(a * b for a, b in pairwise((m.na + m.nb, *m.hidden, 1)))
        if m.kind == "narx" and weights > _WEIGHTS:
            raise ConfigError(
                f"{where}: model {shown(m.name)} has about {weights:.1g} weights; expected at most {_WEIGHTS:.0g}: "
                "choose fewer or smaller entries of hidden"
            )
    out = PurePath(settings.out)
    if PureWindowsPath(settings.out).anchor or out.is_absolute() or normpath(out).split(sep)[0] == "..":
        raise ConfigError(
            f"{where}: out is {shown(settings.out)}; expected a folder below the one that the job is run in: name any "
            "other on the command line, with --out"
        )
    if settings.controller is not None and settings.controller.model not in names:
        wanted = settings.controller.model
        raise ConfigError(
            f"{where}: [controller] uses the model {shown(wanted)}; {nearest(wanted, names)}: use one of these names"
        )


def _record(cls: type[T], table: dict[str, Any], where: str) -> T:
    """A dataclass from a table, unknown and missing entries refused."""
    hints = typing.get_type_hints(cls, include_extras=True)
    known = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    for key in table:
        if key not in known:
            raise ConfigError(f"{where} has no entry {shown(key)}; {nearest(key[:60], known)}: use one of these names")
    for name, f in known.items():
        if name not in table and f.default is MISSING and f.default_factory is MISSING:
            raise ConfigError(f"{where} lacks the entry '{name}'; expected it: add {name} = ...")
    return cls(**{key: _value(value, hints[key], f"{where}: {key}") for key, value in table.items()})


def _value(value: Any, hint: Any, where: str) -> Any:
    """One entry, converted to what the record's field says."""
    if typing.get_origin(hint) is Annotated:
        inner, *more = typing.get_args(hint)
        number = _value(value, inner, where)
        for span in more:
            if not span.low <= number <= span.high:
                unit = f" {span.unit}" if span.unit else ""
                raise ConfigError(
                    f"{where} is {shown(number)}{unit}; expected {span.low:g} to {span.high:g}{unit}: correct it"
                )
        return number
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is types.UnionType or origin is typing.Union:
        return _value(value, next(a for a in arguments if a is not type(None)), where)
    if origin is Literal:
        if value not in arguments:
            raise ConfigError(
                f"{where} is {shown(value)}; {nearest(str(value)[:60], map(str, arguments))}: use one of these"
            )
        return value
    if origin is tuple:
        items = value if isinstance(value, list | tuple) else [value]  # one entry may stand without brackets
        _bounded(len(items), _MANY, where)
        if items is not value and not isinstance(value, str | dict) and not _is_number(value):
            raise ConfigError(f"{where} is {shown(value)}; expected a list")
        return tuple(_value(v, arguments[0], f"{where}[{i}]") for i, v in enumerate(items))
    if origin is dict:
        if not isinstance(value, dict):
            raise ConfigError(f"{where} is {shown(value)}; expected a table of name = value")
        _bounded(len(value), _WIDE, where)
        return {k: _value(v, arguments[1], f"{where}.{shown(k)[1:-1]}") for k, v in value.items()}
    if hasattr(hint, "__dataclass_fields__"):
        if hint is ColumnSettings and isinstance(value, str):
            return ColumnSettings(column=value)
        if not isinstance(value, dict):
            raise ConfigError(f"{where} is {shown(value)}; expected a table")
        return _record(hint, value, where)
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > _LARGEST:
        raise ConfigError(f"{where} is {shown(value)}; expected a number of at most {len(str(_LARGEST))} digits")
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool):
        raise ConfigError(f"{where} is {shown(value)}; expected {_SPOKEN.get(hint, hint.__name__)}")
    if isinstance(value, float) and not isfinite(value):
        raise ConfigError(f"{where} is {value}; expected a finite number")
    return value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _bounded(count: int, most: int, where: str) -> None:
    if count > most:
        raise ConfigError(f"{where} has {count} entries; expected at most {most}")


_SPOKEN = {float: "a number", int: "a whole number", str: "text in quotes", bool: "true or false"}
