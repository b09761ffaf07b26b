"""What a job is: a TOML file read into frozen records, every entry checked."""

from __future__ import annotations

import tomllib
import types
import typing
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, TypeVar

from slipangle.errors import ConfigError, MissingFileError, nearest, shown

T = TypeVar("T")
_LARGEST = 10**15  # of the whole numbers in a job


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
    dt: float | None = None
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    rate: float | None = None
    cutoff: float | None = None
    despike: tuple[str, ...] = ()
    hold: Literal["sample", "mean"] = "sample"
    nan: Literal["error", "gap"] = "error"
    train: float = 0.7


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
    na: int = 2
    nb: int = 2
    nk: int = 1
    nc: int = 1
    nd: int = 1
    nf: int = 2
    order: tuple[int, ...] = ()
    focus: Literal["prediction", "simulation"] = "prediction"
    offset: bool = True
    hidden: tuple[int, ...] = (30, 30)
    seeds: tuple[int, ...] = (0,)
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    published: PublishedSettings | None = None


@dataclass(frozen=True, kw_only=True)
class PlantSettings:
    """The car that the controller drives in simulation."""

    catalogue: str = ""
    friction: float = 1.0
    noise: dict[str, float] = field(default_factory=dict)
    seed: int = 0


@dataclass(frozen=True, kw_only=True)
class ControllerSettings:
    """The predictive controller and its test."""

    model: str
    manoeuvre: Literal["iso3888-1", "iso3888-2", "lane-changes"] = "iso3888-1"
    solver: Literal["ipopt", "realtime"] = "ipopt"
    v_x: float = 20.0
    dt: float = 0.05
    horizon: int = 20
    steps: tuple[int, ...] = ()
    width: float = 1.8
    Q: dict[str, float] = field(default_factory=lambda: {"X": 0.1, "Y": 1.0, "psi": 1.0})
    S: dict[str, float] = field(default_factory=lambda: {"delta": 50.0})
    delta_max: float = 20.0
    delta_rate_max: float = 60.0


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
        Folder for the results.
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
    if len(set(names)) < len(names):
        raise ConfigError(f"{where}: model names repeat in {names}; expected each once: rename one")
    if settings.controller is not None and settings.controller.model not in names:
        wanted = settings.controller.model
        raise ConfigError(
            f"{where}: [controller] uses the model '{wanted}'; {nearest(wanted, names)}: use one of these names"
        )


def _record(cls: type[T], table: dict[str, Any], where: str) -> T:
    """A dataclass from a table, unknown and missing entries refused."""
    hints = typing.get_type_hints(cls)
    known = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    for key in table:
        if key not in known:
            raise ConfigError(f"{where} has no entry '{key}'; {nearest(key, known)}: use one of these names")
    for name, f in known.items():
        if name not in table and f.default is MISSING and f.default_factory is MISSING:
            raise ConfigError(f"{where} lacks the entry '{name}'; expected it: add {name} = ...")
    return cls(**{key: _value(value, hints[key], f"{where}: {key}") for key, value in table.items()})


def _value(value: Any, hint: Any, where: str) -> Any:
    """One entry, converted to what the record's field says."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is types.UnionType or origin is typing.Union:
        return _value(value, next(a for a in arguments if a is not type(None)), where)
    if origin is Literal:
        if value not in arguments:
            raise ConfigError(
                f"{where} is {shown(value)}; {nearest(str(value), map(str, arguments))}: use one of these"
            )
        return value
    if origin is tuple:
        items = [value] if isinstance(value, str | dict) else value
        if not isinstance(items, list | tuple):
            raise ConfigError(f"{where} is {shown(value)}; expected a list")
        return tuple(_value(v, arguments[0], f"{where}[{i}]") for i, v in enumerate(items))
    if origin is dict:
        if not isinstance(value, dict):
            raise ConfigError(f"{where} is {shown(value)}; expected a table of name = value")
        return {k: _value(v, arguments[1], f"{where}.{k}") for k, v in value.items()}
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
    return value


_SPOKEN = {float: "a number", int: "a whole number", str: "text in quotes", bool: "true or false"}
