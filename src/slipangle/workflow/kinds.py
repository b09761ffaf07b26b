"""Kinds of models that a job may name: physics whose parameters are fitted, and estimators of black boxes.

A package adds its own with ``@KINDS.register("name")`` above a model with named parameters or above an estimator's
class (or a function that returns one), or by an entry point of the group ``slipangle.kinds``. The entries that such a
kind takes in a job's ``[[model]]`` are the arguments of what is registered.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from itertools import pairwise
from typing import Annotated, Any, Literal, get_type_hints

from slipangle.data.dataset import Dataset
from slipangle.errors import ConfigError, nearest, shown
from slipangle.identify.car.identify_car import WholeCar
from slipangle.identify.judge.compare import Estimator
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.multi_arx import MultiARX
from slipangle.identify.linear.orders import LEVELS, Chosen
from slipangle.identify.linear.polynomial import ARMAX, BoxJenkins, OutputError
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.physics.at_the_limit import Gain, Mass, ToFrontAxle, Wheelbase
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.model import Model
from slipangle.models.ode import OdeModel
from slipangle.models.parameters import ParameterSet
from slipangle.models.vehicles import catalogue
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.longitudinal import Longitudinal
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle
from slipangle.models.wrappers.delayed import Delayed
from slipangle.registry import Registry
from slipangle.workflow.entries import Lags, Seed, Within, arguments, record

PerInput = Lags | tuple[Lags, ...]  # one number, or one for each input
_WEIGHTS = 1_000_000  # of a network


@dataclass(frozen=True, kw_only=True)
class Physics:
    """A kind whose parameters `GreyBox` fits: those that are free unless the job says others, start values by name."""

    model: type[OdeModel]
    free: tuple[str, ...] = ()
    catalogue: Mapping[str, ParameterSet] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class PhysicsEntries:
    """What a job says about a physical model: parameter values or a name of its catalogue, and which are free.

    Those of ``per_experiment`` have one value for each file, and for each stretch of a file between gaps.
    """

    car: dict[str, float] = field(default_factory=dict)
    catalogue: str = ""
    free: tuple[str, ...] = ()
    per_experiment: tuple[str, ...] = ()


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


KINDS.register("car")(WholeCar)


@KINDS.register("arx")
def _arx(
    *,
    na: Chosen | Lags = "chosen",
    nb: Chosen | PerInput = "chosen",
    nk: Chosen | PerInput | None = None,
    offset: bool = False,
) -> Estimator:
    return ARX(na=na, nb=nb, nk=nk, offset=offset)


@KINDS.register("multi-arx")
def _multi_arx(
    *,
    na: Chosen | Lags = "chosen",
    nb: Chosen | Lags = "chosen",
    nk: Chosen | Lags | None = None,
    speeds: tuple[float, ...] = (),
    offset: bool = True,
) -> Estimator:
    return MultiARX(na=na, nb=nb, nk=nk, speeds=speeds, offset=offset)


@KINDS.register("armax")
def _armax(*, na: Lags = 2, nb: PerInput = 2, nc: Lags = 1, nk: PerInput = 1, offset: bool = False) -> Estimator:
    return ARMAX(na=na, nb=nb, nc=nc, nk=nk, offset=offset)


@KINDS.register("output-error")
def _output_error(*, nb: PerInput = 2, nf: PerInput = 2, nk: PerInput = 1, offset: bool = False) -> Estimator:
    return OutputError(nb=nb, nf=nf, nk=nk, offset=offset, max_radius=1.0)


@KINDS.register("box-jenkins")
def _box_jenkins(
    *, nb: PerInput = 2, nf: PerInput = 2, nc: Lags = 1, nd: Lags = 1, nk: PerInput = 1, offset: bool = False
) -> Estimator:
    return BoxJenkins(nb=nb, nf=nf, nc=nc, nd=nd, nk=nk, offset=offset)


@KINDS.register("state-space")
def _state_space(
    *,
    order: tuple[Annotated[int, Within(1, 50)], ...] = (),
    focus: Literal["prediction", "simulation"] = "simulation",
    nk: Lags = 1,
    offset: bool = False,
) -> Estimator:
    orders = order[0] if len(order) == 1 else order or StateSpace.order
    offsets = "output" if offset else "none"
    return StateSpace(order=orders, focus=focus, offsets=offsets, direct=nk == 0, max_radius=1.0)


@KINDS.register("narx")
def _narx(
    *,
    na: Chosen | Lags = "chosen",
    nb: Chosen | Lags = "chosen",
    nk: Chosen | Lags | None = None,
    hidden: tuple[Annotated[int, Within(1, 1000)], ...] = (30, 30),
    seeds: tuple[Seed, ...] = (0,),
) -> Estimator:
    from slipangle.identify.networks.narx import NARX  # brings JAX

    return NARX(na=na, nb=nb, nk=nk, hidden=hidden, seeds=seeds)


@KINDS.register("hybrid")
def _hybrid(
    *,
    mass: Mass,
    wheelbase: Wheelbase,
    l_f: ToFrontAxle,
    steering_gain: Gain = 1.0,
    hidden: tuple[Annotated[int, Within(1, 1000)], ...] = (40, 40),
    epochs: tuple[Annotated[int, Within(1, 100_000)], ...] = (200, 1000),
    seeds: tuple[Seed, ...] = (0,),
) -> Estimator:
    from slipangle.identify.networks.hybrid import Hybrid  # brings JAX
    from slipangle.identify.networks.presets import SOUSA_TABLE_8_2

    if len(epochs) != len(SOUSA_TABLE_8_2.stages):
        raise ConfigError(
            f"a hybrid's epochs are {list(epochs)}; expected two numbers: one step ahead, then 40 steps ahead"
        )
    stages = tuple(replace(stage, epochs=n) for stage, n in zip(SOUSA_TABLE_8_2.stages, epochs, strict=True))
    network = replace(SOUSA_TABLE_8_2, hidden=hidden, stages=stages, seeds=seeds)
    return Hybrid(mass=mass, wheelbase=wheelbase, l_f=l_f, steering_gain=steering_gain, discrepancy=network)


@KINDS.register("joint")
def _joint(
    *,
    mass: Mass,
    wheelbase: Wheelbase,
    l_f: ToFrontAxle,
    steering_gain: Gain = 1.0,
    hidden: tuple[Annotated[int, Within(1, 1000)], ...] = (24,),
    max_iterations: Annotated[int, Within(1, 10_000)] = 80,
    seeds: tuple[Seed, ...] = (0,),
) -> Estimator:
    from slipangle.identify.networks.joint import Joint  # brings JAX

    known: Any = {"mass": mass, "wheelbase": wheelbase, "l_f": l_f, "steering_gain": steering_gain}
    return Joint(**known, hidden=hidden, max_iterations=max_iterations, seeds=seeds)


def check_entries(kind: str, table: dict[str, Any], where: str) -> dict[str, Any]:
    """A model's entries beside those that every model has.

    Raises ConfigError if there is no such kind, or it has no such entry, or needs another one, or of another type.
    """
    if kind not in KINDS:
        raise ConfigError(f"{where}: kind is {shown(kind)}; {nearest(kind[:60], KINDS)}: use one of these")
    thing = KINDS[kind]
    if _physics(thing) is not None:
        return vars(record(PhysicsEntries, table, where))
    own = arguments(thing, table, where)  # type: ignore[arg-type]  # all others are callable
    if kind == "narx":
        lags = sum(n if isinstance(n, int) else LEVELS[-1] for n in (own.get("na"), own.get("nb")))
        weights = sum(a * b for a, b in pairwise((lags, *own.get("hidden", ()), 1)))
        if weights > _WEIGHTS:
            raise ConfigError(
                f"{where} has about {weights:.1g} weights; expected at most {_WEIGHTS:.0g}: choose fewer or smaller "
                "entries of hidden"
            )
    return own


def fitted(
    thing: Kind,
    entries: Mapping[str, Any],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    train: Dataset,
    name: str,
) -> Model:
    """The model of a kind, fitted to training data; entries as of `check_entries`, channels by default all."""
    physics = _physics(thing)
    if physics is None:
        return thing(**entries).fit(train.select(inputs=inputs or None, outputs=outputs or None))  # type: ignore[operator]
    start = _start(physics, PhysicsEntries(**entries), outputs, train, name)
    each = entries["per_experiment"]
    free = entries["free"] or tuple(n for n in physics.free if n not in each)
    late = {n.removeprefix("delay_"): 0.5 * train.dt for n in (*free, *each) if n.startswith("delay_")}
    return GreyBox(start=Delayed(start, delays=late) if late else start, free=free, per_experiment=each).fit(train)


def _physics(thing: Any) -> Physics | None:
    if isinstance(thing, Physics):
        return thing
    return Physics(model=thing) if isinstance(thing, type) and issubclass(thing, OdeModel) else None


def _start(physics: Physics, wanted: PhysicsEntries, outputs: tuple[str, ...], train: Dataset, name: str) -> OdeModel:
    kind: type[ParameterSet] = get_type_hints(physics.model)["params"]
    if wanted.catalogue:
        if wanted.catalogue not in physics.catalogue:
            raise ConfigError(
                f"model '{name}': there is no {physics.model.__name__} '{wanted.catalogue}' in the catalogue; "
                f"{nearest(wanted.catalogue, physics.catalogue)}: use one of these names"
            )
        params: Any = physics.catalogue[wanted.catalogue].with_values(**wanted.car)
    else:
        for parameter in wanted.car:
            kind.si(parameter)
        try:
            params = kind(**wanted.car)
        except TypeError:
            optional = {f.name for f in fields(kind) if f.default is not MISSING or f.default_factory is not MISSING}
            needed = [n for n in kind.metadata() if n not in wanted.car and n not in optional]
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
