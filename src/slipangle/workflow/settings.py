"""What a job is: a TOML file read into frozen records, every entry checked."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from os.path import normpath, sep
from pathlib import Path, PurePath, PureWindowsPath
from typing import Annotated, Any, Literal, Self

from slipangle.data.clock import JITTER
from slipangle.data.readers.column import Column
from slipangle.errors import ConfigError, nearest, shown
from slipangle.files import read_bytes
from slipangle.workflow.drive import ControllerSettings, EstimatorSettings, PlantSettings, require_car
from slipangle.workflow.entries import Within, common, record
from slipangle.workflow.kinds import CARLESS, KINDS, check_entries, named_logs, needed
from slipangle.workflow.lap_settings import LapSettings
from slipangle.workflow.race_settings import RaceSettings
from slipangle.workflow.tires import TIRES, located


@dataclass(frozen=True, kw_only=True)
class ColumnSettings:
    """Where a channel is in the file, in which unit, and what makes it ours; see `slipangle.data.readers.Column`.

    Parameters
    ----------
    column : str
        Name in the file's header, with or without its unit.
    unit : str
        Unit of the file's numbers; by default the one in the header, or that the name there ends with (speed_kmh).
    override : bool
        Take ``unit`` even if the header names another one.
    scale, offset : float
        Of raw counts: physical = scale * raw + offset, in ``unit``.
    sign : int
        -1 where the file counts the other way: delta, r, v_y and a_y are positive to the left.
    ratio : float
        Of the steering: hand wheel angle over road wheel angle.
    derive : str
        Arithmetic on other channels and columns in SI units, in place of a column, such as "curvature * v_x".
    """

    column: str = ""
    unit: str = ""
    override: bool = False
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
            override=self.override,
            scale=self.scale,
            offset=self.offset,
            sign=self.sign,
            ratio=self.ratio,
            derive=self.derive or None,
        )


@dataclass(frozen=True, kw_only=True)
class DataSettings:
    """The log: files with named columns, or a public data set.

    Parameters
    ----------
    file : tuple of str
        Files to identify from, relative to the job, patterns such as "run*.csv" among them.
    beside : tuple of str
        Files of the same drive and clock as a single ``file``, with more channels.
    test : tuple of str
        Files to judge on, which no pattern of ``file`` takes.
    set : str
        A public data set in place of files; see 'slipangle data list'.
    columns : table
        Where each channel is in the files, by the channel's name; by default headings are the names.
    time : table or str
        The time column; by default one called t, time or timestamp.
    dt : float
        Sample time, for files without time or with stamps too coarse to rise from row to row. [s]
    inputs : tuple of str
        Channels that drive the system.
    outputs : tuple of str
        Channels that are to be explained.
    rate : float
        What the log is resampled to, after a zero-phase low-pass. [Hz]
    cutoff : float
        Of that low-pass; by default 0.4 times the rate, and without a rate the log is low-passed at its own. [Hz]
    despike : tuple of str
        Channels whose spikes are replaced by what lies between their neighbours.
    hold : str
        Whether an input's sample holds until the next one, or stands for the mean until then.
    nan : str
        Whether missing numbers are an error, cut the log, or belong to columns with rates of their own.
    jitter : float
        Largest variation of a time step, as a share of it, that is put back on an even clock. [-]
    filter : str
        A condition on channels and t, in SI units, such as "v_x > 5 and t < 200"; other rows are cut.
    train : float
        First part of the log, that is identified from; the rest is judged on, but all is identified from where there
        are ``test`` files.
    start : int
        Samples of each test record whose measured outputs tell the model's initial state; they do not count in its
        scores.
    opening : float
        First part of the test record, from which models with ``per_experiment`` parameters read those of that day; no
        model is judged on it. [s]
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
    jitter: Annotated[float, Within(0.0, 1.0)] = JITTER
    filter: str = ""
    train: Annotated[float, Within(0.01, 0.99)] = 0.7
    start: Annotated[int, Within(1, 1_000_000, "samples")] | None = None
    opening: Annotated[float, Within(0.1, 1e5, "s")] | None = None


@dataclass(frozen=True, kw_only=True)
class PublishedSettings:
    """Somebody else's numbers on the same car, shown beside ours.

    Parameters
    ----------
    source : str
        Where they are from.
    fit : float
        Of the first output's free run. [%]
    vaf : float
        Variance that it accounts for. [%]
    rmse : float
        Root mean square of its error, in the output's unit.
    """

    source: str
    fit: float | None = None
    vaf: float | None = None
    rmse: float | None = None


@dataclass(frozen=True, kw_only=True)
class ModelSettings:
    """One model to identify: what the page calls it, one of `slipangle.workflow.kinds.KINDS`, and its channels.

    Parameters
    ----------
    name : str
        What the page calls it; each of a job's models has its own.
    kind : str
        What it is; see 'slipangle list models'. The table's other entries are those of the kind.
    inputs : tuple of str
        Channels that it is driven by; by default all inputs of the data.
    outputs : tuple of str
        Channels that it explains; by default all outputs of the data.
    published : table
        Somebody else's numbers, shown beside ours.
    entries : dict
        The table's other ones: the settings that the kind takes, checked.
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

    Parameters
    ----------
    title : str
        Of the page.
    subtitle : str
        Second line of the page's title.
    data : table
        The log.
    model : list of tables
        What is identified from it, one ``[[model]]`` each.
    controller : table
        What drives one of the models' cars in simulation; without it nothing drives.
    plant : table
        The car that is driven; by default one made of the identified bicycle.
    estimator : table
        What tells the controller the state from measurements; without it the outputs of its model correct it.
    lap : table
        The fastest lap of one of the models' cars, for ``slipangle lap``.
    race : table
        Laps on that track by a racer on a plant, which ``slipangle lap`` then drives too; without it nothing races.
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
    estimator: EstimatorSettings | None = None
    lap: LapSettings = field(default_factory=LapSettings)
    race: RaceSettings | None = None
    out: str = "slipangle-out"
    folder: Path = field(default=Path(), repr=False, metadata={"in_jobs": False})

    def model_order(self) -> tuple[ModelSettings, ...]:
        """The models, each after those that it is made of; raises CycleError if they go round in a circle."""
        by_name = {m.name: m for m in self.model}
        order = TopologicalSorter({m.name: needed(m.entries) for m in self.model}).static_order()
        return tuple(by_name[name] for name in order)


def read_settings(path: str | Path) -> Settings:
    """Read a job's TOML file.

    Raises MissingFileError if the file does not exist, and ConfigError if an entry is unknown, missing or of the wrong
    type; the nearest names are given.
    """
    file = Path(path)
    try:
        text = read_bytes(file, "the settings file", "a TOML file: see examples/ferrari_250lm.toml").decode("utf-8-sig")
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
    settings = _placed(record(Settings, table, file.name), file.parent)
    _check(settings, file.name)
    return _with_tires(settings, file.name)


def _with_tires(settings: Settings, where: str) -> Settings:
    """The job with its tire files where they are, from its folder."""
    models = tuple(
        replace(m, entries=located(m.entries, settings.folder, f"{where}: model {shown(m.name)}"))
        for m in settings.model
    )
    own = {key: getattr(settings.plant, key) for key in TIRES}
    plant = replace(settings.plant, **located(own, settings.folder, f"{where}: [plant]"))
    return replace(settings, model=models, plant=plant)


def _placed(settings: Settings, folder: Path) -> Settings:
    """The same with every file that a model, the controller or the plant names in the folder of the job."""
    models = tuple(replace(m, entries=_in_folder(m.entries, folder)) for m in settings.model)
    controller = settings.controller
    if controller is not None and controller.track is not None:
        controller = replace(controller, track=folder / controller.track)
    plant = replace(settings.plant, entries=_in_folder(settings.plant.entries, folder))
    files = {k: folder / v for k in ("track", "driven") if (v := getattr(settings.lap, k)) is not None}
    lap = replace(settings.lap, **files)
    return replace(settings, folder=folder, model=models, controller=controller, plant=plant, lap=lap)


def _in_folder(entries: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    return {k: folder / v if isinstance(v, Path) else v for k, v in entries.items()}


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
    asking = next((m for m in settings.model if named_logs(m.entries)), None)
    if settings.data.beside and asking is not None:
        raise ConfigError(
            f"{where}: [data] names files beside its own, and model {shown(asking.name)} those of another log as "
            f"{next(iter(named_logs(asking.entries)))}; expected files that need no others: merge each drive's into one"
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
    for model in settings.model:
        for other in needed(model.entries):
            if other not in names:
                raise ConfigError(
                    f"{where}: model {shown(model.name)} needs {shown(other)}, which the job has not; "
                    f"{nearest(other, names, every=True)}: name one of these"
                )
    try:
        settings.model_order()
    except CycleError as error:
        circle = " needs ".join(shown(n) for n in reversed(error.args[1]))
        raise ConfigError(f"{where}: model {circle}; expected one to begin with: break the circle") from None
    out = PurePath(settings.out)
    if PureWindowsPath(settings.out).anchor or out.is_absolute() or normpath(out).split(sep)[0] == "..":
        raise ConfigError(
            f"{where}: out is {shown(settings.out)}; expected a folder below the one that the job is run in: name any "
            "other on the command line, with --out"
        )
    _check_controller(settings, names, where)


def _check_controller(settings: Settings, names: list[str], where: str) -> None:
    if settings.controller is None:
        return
    wanted = settings.controller.model
    if wanted not in names:
        raise ConfigError(
            f"{where}: [controller] uses the model {shown(wanted)}; {nearest(wanted, names)}: use one of these names"
        )
    if KINDS[settings.model[names.index(wanted)].kind] in CARLESS:
        require_car(settings.controller, settings.plant)
