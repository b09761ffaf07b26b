"""Kinds of models that a job may name: physics whose parameters are fitted, and estimators of black boxes.

A package adds its own with ``@KINDS.register("name")`` above a model with named parameters or above an estimator's
class (or a function that returns one), or by an entry point of the group ``slipangle.kinds``. The entries that such a
kind takes in a job's ``[[model]]`` are the arguments of what is registered.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Self, get_type_hints

from slipangle.data.dataset import Dataset
from slipangle.errors import ConfigError, FormatError, ParameterError, nearest, shown
from slipangle.estimate.ekf import EKF
from slipangle.fields import Checked
from slipangle.identify.adapt import Adapt
from slipangle.identify.car.identify_car import WholeCar
from slipangle.identify.judge.compare import Estimator
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.multi_arx import MultiARX
from slipangle.identify.linear.orders import LEVELS
from slipangle.identify.linear.pem import PEM
from slipangle.identify.linear.polynomial import ARMAX, BoxJenkins, OutputError, Polynomial
from slipangle.identify.linear.process import ProcessModel
from slipangle.identify.linear.recursive import RLS
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.linear.subspace import Subspace
from slipangle.identify.linear.transfer_function import TransferFunction
from slipangle.identify.lure.lure import Lure
from slipangle.identify.networks.hybrid import Hybrid
from slipangle.identify.networks.joint import Joint
from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.narx_free_run import FreeRunNARX
from slipangle.identify.networks.neural_statespace import NeuralStateSpace
from slipangle.identify.physics.collocation import Collocation
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.identify.physics.tire_bicycle_fit import TireBicycleFit
from slipangle.models.model import Model
from slipangle.models.ode import OdeModel
from slipangle.models.parameters import ParameterSet
from slipangle.models.storage import load
from slipangle.models.vehicles import catalogue
from slipangle.models.vehicles.aided import RearSteered, TorqueVectored
from slipangle.models.vehicles.banked import Banked
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.kinematic import Kinematic
from slipangle.models.vehicles.load_transfer import LoadTransfer
from slipangle.models.vehicles.longitudinal import Longitudinal
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle
from slipangle.models.vehicles.saturating_bicycle import RelaxingBicycle, SaturatingBicycle
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.hybrid import OffsetModel
from slipangle.registry import Registry
from slipangle.workflow.entries import Made, OtherLogs, OtherModel, arguments, entries_of, of_kind, record
from slipangle.workflow.hints import called, is_model, is_record, parts

_WEIGHTS = 1_000_000  # of a network
_LAG, _RATE = 0.05, 2.0  # s and rad/s that a fit of an actuator starts from
AROUND = tuple(n for kind in (Steered, RearSteered, TorqueVectored, LoadTransfer) for n in kind.own)  # a job's car
_HEIGHT, _LOAD_LAG = 0.2, 0.05  # wheelbases and s, that one of load transfer starts from


@dataclass(frozen=True, kw_only=True)
class Physics:
    """A kind whose parameters `GreyBox` fits: those that are free unless the job says others, start values by name."""

    model: type[OdeModel]
    free: tuple[str, ...] = ()
    catalogue: Mapping[str, ParameterSet] = field(default_factory=dict)

    @property
    def parameters(self) -> type[ParameterSet]:
        """Record of the model's parameters."""
        return get_type_hints(self.model)["params"]


FITS: Registry[Callable[..., Any]] = Registry("way of fitting", "slipangle.fits")
"""What ``kind`` in ``fit = { ... }`` of a physical model may be: called with ``start``, ``free`` and its entries."""

for _way in (GreyBox, Collocation, EKF):
    FITS.register(called(_way))(Made(_way, ("start", "free", "per_experiment"), _way))


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """How the parameters of a physical model are fitted.

    Parameters
    ----------
    kind : str
        One of 'slipangle list fits'. The table's other entries are those of the kind.
    entries : dict
        These, checked.
    """

    kind: str = "grey-box"
    entries: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def from_table(cls, table: dict[str, Any], where: str) -> Self:
        """Entries of every way, and those of its kind."""
        return of_kind(cls, FITS, table, where)

    def fitted(self, start: Any, free: tuple[str, ...], each: tuple[str, ...], train: Dataset) -> Model:
        """The model with its free parameters fitted, those of ``each`` one by one for every experiment.

        Raises ParameterError if this way of fitting knows no parameters of single experiments.
        """
        made = FITS[self.kind]
        several = {"per_experiment": each} if each else {}
        if each and "per_experiment" not in {f.name for f in fields(getattr(made, "of", GreyBox))}:
            raise ParameterError(f'a fit of kind "{self.kind}" knows no per_experiment; expected none: leave it out')
        return made(start=start, free=free, **several, **self.entries).fit(train)


@dataclass(frozen=True, kw_only=True)
class PhysicsEntries:
    """What a job says about a physical model: parameter values or a name of its catalogue, and which are free.

    Parameters
    ----------
    car : table
        Parameters by name, SI units: known values, and start values of free ones.
    catalogue : str
        A car whose values stand where ``car`` says none.
    free : tuple of str
        Parameters that are fitted; ``delay_`` before an input is its delay, steering_lag and steering_rate are those of
        an actuator where the model has none, height, load_lag, drive_rear and brake_rear those of a car whose loads
        shift as it brakes.
    per_experiment : tuple of str
        Parameters with one value for each file, and for each stretch of a file between gaps.
    banked : bool
        The road has a cross slope: an input ``bank``, a channel of the log. [rad]
    rear_steered : bool
        The rear wheels are steered too: an input ``delta_r``, a channel of the log. [rad]
    torque_vectored : bool
        Drive or brakes turn the car: an input ``M_z``, their yaw moment, a channel of the log. [N m]
    fit : table
        How it is fitted; by default by the free-run error.
    """

    car: dict[str, float] = field(default_factory=dict)
    catalogue: str = ""
    free: tuple[str, ...] = ()
    per_experiment: tuple[str, ...] = ()
    banked: bool = False
    rear_steered: bool = False
    torque_vectored: bool = False
    fit: FitSettings = field(default_factory=FitSettings)


Kind = Physics | type[OdeModel] | type[Estimator] | Callable[..., Estimator]

KINDS: Registry[Kind] = Registry("model kind", "slipangle.kinds")
"""What ``kind = "..."`` in a job's ``[[model]]`` may be."""

KINDS.register("bicycle")(
    Physics(
        model=Bicycle,
        free=("C_f", "C_r", "inertia_z"),
        catalogue={"ferrari-250lm": catalogue.FERRARI_250LM, "sousa-table-7.2": catalogue.SOUSA_TABLE_7_2},
    )
)
KINDS.register("nonlinear-bicycle")(
    Physics(model=NonlinearBicycle, free=("C_f", "C_r", "inertia_z", "mu_f", "mu_r", "steering_lag", "steering_offset"))
)
KINDS.register("longitudinal")(Physics(model=Longitudinal, free=("k_e", "k_d", "k_r")))
KINDS.register("kinematic")(Physics(model=Kinematic, free=("steering_gain", "steering_offset")))
_SATURATING = ("C_f", "C_r", "inertia_z", "mu_f", "mu_r")
KINDS.register("saturating-bicycle")(Physics(model=SaturatingBicycle, free=_SATURATING))
KINDS.register("relaxing-bicycle")(Physics(model=RelaxingBicycle, free=(*_SATURATING, "relaxation_f", "relaxation_r")))

KINDS.register("car")(WholeCar)
_BLACK: tuple[Any, ...] = (
    *(ARX, MultiARX, Polynomial, ARMAX, OutputError, BoxJenkins, ProcessModel, TransferFunction, RLS, Subspace, PEM),
    *(StateSpace, Lure, NARX, FreeRunNARX),
)
for _estimator in (*_BLACK, Hybrid):
    KINDS.register(called(_estimator))(_estimator)
KINDS.register("joint")(Joint)
KINDS.register("neural-state-space")(NeuralStateSpace)
CARLESS = (*_BLACK, NeuralStateSpace)  # kinds whose models hold no mass, geometry and cornering stiffness
KINDS.register("tire-bicycle")(TireBicycleFit)


@KINDS.register("adapt")
@dataclass(frozen=True, kw_only=True)
class Adapted(Checked):
    """Another model, with what the sensors of this log read differently from those that it was fitted to.

    Parameters
    ----------
    model : Model
        The model that is adapted, such as a saved one.
    train : Dataset
        Files that it was fitted to, read like the job's own: corrections then do harm less often.
    settings : Adapt
        What may differ, and by how much.
    """

    model: Model
    train: Dataset | None = None
    settings: Adapt = field(default_factory=Adapt)

    def fit(self, data: Dataset) -> OffsetModel:
        """See `slipangle.identify.adapt.Adapt.fit`."""
        return self.settings.fit(self.model, data, self.train)


@KINDS.register("saved")
@dataclass(frozen=True, kw_only=True)
class Saved(Checked):
    """A model that 'slipangle identify' or `slipangle.save` wrote, as it is.

    Parameters
    ----------
    file : Path
        Relative to the job.
    """

    file: Path

    def fit(self, data: Dataset) -> Model:
        """The model of the file, if the data are at its sample time and have its channels."""
        model = load(self.file)
        if not isinstance(model, Model):
            raise FormatError(f"'{self.file}' holds a {type(model).__name__}; expected a model: name another file")
        model.check(data.select(inputs=model.inputs, outputs=model.outputs))
        return model


def check_entries(kind: str, table: dict[str, Any], where: str) -> dict[str, Any]:
    """A model's entries beside those that every model has.

    Raises ConfigError if there is no such kind, or it has no such entry, or needs another one, or of another type.
    """
    if kind not in KINDS:
        raise ConfigError(f"{where}: kind is {shown(kind)}; {nearest(kind[:60], KINDS)}: use one of these")
    thing = KINDS[kind]
    physics = as_physics(thing)
    if physics is not None:
        entries = vars(record(PhysicsEntries, table, where))
        known = (*physics.parameters.metadata(), *AROUND)
        for name in entries["car"]:
            if name not in known:
                near = nearest(name[:60], known, every=True)
                raise ConfigError(f"{where}: car has no parameter {shown(name)}; {near}: use one of these names")
        return entries
    own = arguments(thing, table, where)  # type: ignore[arg-type]  # all others are callable
    _no_giant(own, where)
    others = any(isinstance(v, OtherModel | OtherLogs) for v in own.values())
    if isinstance(thing, type) and is_dataclass(thing) and not others:
        try:
            thing(**own)
        except ParameterError as error:
            raise ConfigError(f"{where}: {error}") from None
    return own


def _no_giant(entries: Mapping[str, Any], where: str) -> None:
    """Raise ConfigError if a network would have more weights than a machine holds."""
    lags = sum(n if isinstance(n, int) else LEVELS[-1] for n in (entries.get("na"), entries.get("nb")))
    weights = sum(a * b for a, b in pairwise((lags, *entries.get("hidden", ()), 1)))
    if weights > _WEIGHTS:
        raise ConfigError(
            f"{where} has about {weights:.1g} weights; expected at most {_WEIGHTS:.0g}: choose fewer or smaller "
            "entries of hidden"
        )
    for key, value in entries.items():
        if is_record(type(value)):
            _no_giant(vars(value), f"{where}: {key}")


def fitted(
    thing: Kind,
    entries: Mapping[str, Any],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    train: Dataset,
    name: str,
    others: Mapping[str, Model] | None = None,
    logs: Mapping[OtherLogs, Dataset] | None = None,
) -> Model:
    """The model of a kind, fitted to training data; entries as of `check_entries`, channels by default all.

    ``others`` and ``logs`` are what entries name: other models, and the data of other files.

    Raises ParameterError if a model that it needs is not among the ``others``, or of another class than it needs.
    """
    physics = as_physics(thing)
    if physics is None:
        made = thing(**_with_models(thing, _with_logs(entries, logs or {}), others or {}, name))  # type: ignore[operator]
        return made.fit(train.select(inputs=inputs or None, outputs=outputs or None))
    wanted = PhysicsEntries(**entries)
    start = _actuated(_start(physics, wanted, outputs, train, name), wanted, physics)
    each = wanted.per_experiment
    free = wanted.free or tuple(n for n in physics.free if n not in each)
    late = {n.removeprefix("delay_"): 0.5 * train.dt for n in (*free, *each) if n.startswith("delay_")}
    return wanted.fit.fitted(Delayed(start, delays=late) if late else start, free, each, train)


def needed(entries: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the other models that entries of a model speak of."""
    return tuple(str(v) for v in entries.values() if isinstance(v, OtherModel))


def named_logs(entries: Mapping[str, Any]) -> dict[str, OtherLogs]:
    """Files of other logs that entries of a model name, by the entry."""
    return {key: files for key, files in entries.items() if isinstance(files, OtherLogs)}


def _with_logs(entries: Mapping[str, Any], logs: Mapping[OtherLogs, Dataset]) -> dict[str, Any]:
    """Entries with data in place of their files."""
    return {**entries, **{key: logs[files] for key, files in named_logs(entries).items()}}


def _with_models(thing: Any, entries: Mapping[str, Any], others: Mapping[str, Model], name: str) -> dict[str, Any]:
    """Entries with models in place of their names."""
    own, hints = dict(entries), entries_of(thing)
    for key, value in entries.items():
        if not isinstance(value, OtherModel):
            continue
        if value not in others:
            raise ParameterError(f"the model '{value}', which '{name}' needs, could not be fitted: mend that one first")
        classes = tuple(o for o in (hints[key].hint, *parts(hints[key].hint)[1]) if is_model(o))
        if not isinstance(others[value], classes):
            raise ParameterError(
                f"{key} of '{name}' is '{value}', a {type(others[value]).__name__}; expected a "
                f"{' or '.join(c.__name__ for c in classes)}: name another one"
            )
        own[key] = others[value]
    return own


def as_physics(thing: Any) -> Physics | None:
    """A kind whose parameters are fitted; None if it is an estimator."""
    if isinstance(thing, Physics):
        return thing
    return Physics(model=thing) if isinstance(thing, type) and issubclass(thing, OdeModel) else None


def _actuated(start: OdeModel, wanted: PhysicsEntries, physics: Physics) -> OdeModel:
    """The car with steered rear wheels, a yaw moment, on a banked road, with loads that shift, behind a steering."""
    named = {*wanted.free, *wanted.per_experiment, *wanted.car}
    car = RearSteered(start, gain_delta_r=wanted.car.get("gain_delta_r", 1.0)) if wanted.rear_steered else start
    if wanted.torque_vectored:
        car = TorqueVectored(car, gain_M_z=wanted.car.get("gain_M_z", 1.0))
    car = Banked(car) if wanted.banked else car
    of_car = physics.parameters.metadata()
    if {*LoadTransfer.own} & named - {*of_car}:
        usual = {"height": _HEIGHT * start.value("wheelbase"), "load_lag": _LOAD_LAG}
        given: Any = usual | {n: v for n, v in wanted.car.items() if n in LoadTransfer.own}
        car = LoadTransfer(car, **given)
    own = [n for n in Steered.own if n in named and n not in of_car]
    if not own:
        return car
    lag = wanted.car.get("steering_lag", _LAG)
    rate = wanted.car.get("steering_rate", _RATE if "steering_rate" in own else math.inf)
    return Steered(car, steering_lag=lag, steering_rate=rate)


def _start(physics: Physics, wanted: PhysicsEntries, outputs: tuple[str, ...], train: Dataset, name: str) -> OdeModel:
    kind = physics.parameters
    car = {n: v for n, v in wanted.car.items() if n in kind.metadata()}
    if wanted.catalogue:
        if wanted.catalogue not in physics.catalogue:
            fix = "use one of these names" if physics.catalogue else "give its parameters as car = { ... } instead"
            raise ConfigError(
                f"model '{name}': there is no {physics.model.__name__} '{wanted.catalogue}' in the catalogue; "
                f"{nearest(wanted.catalogue, physics.catalogue)}: {fix}"
            )
        params: Any = physics.catalogue[wanted.catalogue].with_values(**car)
    else:
        try:
            params = kind(**car)
        except TypeError:
            optional = {f.name for f in fields(kind) if f.default is not MISSING or f.default_factory is not MISSING}
            needed = [n for n in kind.metadata() if n not in car and n not in optional]
            raise ConfigError(
                f"model '{name}': car lacks {', '.join(needed)}; expected every parameter of the "
                f"{physics.model.__name__} (free ones as start values), or a catalogue name"
            ) from None
    l_f, wheelbase = getattr(params, "l_f", 0.0), getattr(params, "wheelbase", math.inf)
    if not l_f < wheelbase:
        raise ConfigError(
            f"model '{name}': l_f is {l_f:g} m and the wheelbase {wheelbase:g} m; expected the centre of "
            "gravity between the axles: l_f is its distance from the front one"
        )
    return physics.model(params=params, dt=train.dt, outputs=outputs or train.outputs)
