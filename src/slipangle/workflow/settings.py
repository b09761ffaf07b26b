"""What a job is: a TOML file read into frozen records, every entry checked."""

import tomllib
from dataclasses import dataclass, field, replace
from os.path import normpath, sep
from pathlib import Path, PurePath, PureWindowsPath
from typing import Annotated, Any, Literal, Self

from slipangle.data.readers.column import Column
from slipangle.errors import ConfigError, nearest, shown
from slipangle.files import read_bytes
from slipangle.workflow.drive import ControllerSettings, PlantSettings
from slipangle.workflow.entries import Within, common, record
from slipangle.workflow.kinds import check_entries


@dataclass(frozen=True, kw_only=True)
class ColumnSettings:
    """Where a channel is in the file, in which unit, and what makes it ours; see `slipangle.data.readers.Column`."""

    column: str = ""
    unit: str = ""
    scale: Annotated[float, Within(-1e12, 1e12)] = 1.0
    offset: Annotated[float, Within(-1e12, 1e12)] = 0.0
    sign: Literal[1, -1] = 1
    ratio: Annotated[float, Within(-1e3, 1e3)] = 1.0
    derive: str = ""

    @classmethod
    def from_text(cls, column: str) -> Self:
        """The column alone, in SI units or in the unit that its header says."""
        return cls(column=column)

    def to_column(self) -> Column:
        """The same as readers take it.

        Raises ParameterError if it names neither a column nor what to derive it from, or both.
        """
        return Column(
            self.column,
            self.unit or None,
            scale=self.scale,
            offset=self.offset,
            sign=self.sign,
            ratio=self.ratio,
            derive=self.derive or None,
        )


@dataclass(frozen=True, kw_only=True)
class DataSettings:
    """The log: files with named columns, or a public data set.

    ``file`` is one file or several to identify from, patterns such as ``run*.csv`` among them. ``test`` are other files
    to judge on, which no pattern of ``file`` takes; without them the first part, ``train``, of the log is identified
    from and the rest judged on. ``beside`` are files of the same drive and clock as a single ``file``, with more
    channels. ``filter`` is a condition on channels and t, in SI units; other rows are cut. ``start`` is the number of
    samples of each test record whose measured outputs tell the model's initial state; they do not count in its scores.
    """

    file: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
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
    nan: Literal["error", "gap", "merge"] = "error"
    filter: str = ""
    train: Annotated[float, Within(0.01, 0.99)] = 0.7
    start: Annotated[int, Within(1, 1_000_000, "samples")] | None = None


@dataclass(frozen=True, kw_only=True)
class PublishedSettings:
    """Somebody else's numbers on the same car, shown beside ours."""

    source: str
    fit: float | None = None
    vaf: float | None = None
    rmse: float | None = None


@dataclass(frozen=True, kw_only=True)
class ModelSettings:
    """One model to identify: what the page calls it, one of `slipangle.workflow.kinds.KINDS`, and its channels.

    ``entries`` are the table's other ones: the settings that the kind takes, checked.
    """

    name: str
    kind: str
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    published: PublishedSettings | None = None
    entries: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def from_table(cls, table: dict[str, Any], where: str) -> Self:
        """Entries of every model, and those of its kind."""
        model, own = common(cls, table, where)
        return replace(model, entries=check_entries(model.kind, own, f"{where} {shown(model.name)}"))


@dataclass(frozen=True, kw_only=True)
class Settings:
    """A job: the tables of its file. Without a controller it ends with the verdict.

    ``out`` is the folder for the results, below the one that the job is run in; only the command line may name another.
    ``folder`` is where the settings file is; the log's file name is relative to it.
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

    Raises MissingFileError if the file does not exist, and ConfigError if an entry is unknown, missing or of the wrong
    type; the nearest names are given.
    """
    file = Path(path)
    try:
        text = read_bytes(file, "the settings file", "a TOML file: see examples/ferrari_250lm.toml").decode("utf-8")
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
    settings = record(Settings, {**table, "folder": file.parent}, file.name)
    _check(settings, file.name)
    return settings


def _check(settings: Settings, where: str) -> None:
    if bool(settings.data.file) == bool(settings.data.set):
        raise ConfigError(
            f"{where}: [data] names {'both a file and a set' if settings.data.file else 'no log'}; expected either "
            'file = "log.csv" or set = "ferrari-250lm"'
        )
    if settings.data.test and settings.data.set:
        raise ConfigError(
            f"{where}: [data] names test files and a set; expected test files beside files: leave one of them out"
        )
    if settings.data.beside and (len(settings.data.file) != 1 or settings.data.test):
        raise ConfigError(
            f"{where}: [data] names {len(settings.data.file)} files, {len(settings.data.test)} test files and others "
            "beside; expected one file, which those beside it belong to: give each drive a job, or merge them first"
        )
    files = (*settings.data.file, *settings.data.test)
    if len(set(files)) < len(files):
        again = next(n for n in files if files.count(n) > 1)
        how = "for training and for testing" if again in settings.data.test and again in settings.data.file else "twice"
        raise ConfigError(f"{where}: [data] {shown(again)} is named {how}; expected each file once: leave one out")
    if not settings.model:
        raise ConfigError(f"{where} has no [[model]]; expected at least one: add [[model]] with name and kind")
    names = [m.name for m in settings.model]
    if not all(n.strip() for n in names):
        raise ConfigError(f"{where}: a model's name is empty; expected a few letters: give it one")
    if len(set(names)) < len(names):
        again = next(n for n in names if names.count(n) > 1)
        raise ConfigError(f"{where}: model names repeat: {shown(again)}; expected each once: rename one")
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
