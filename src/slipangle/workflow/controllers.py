"""Controllers, and estimators in the loop, that a job may name.

A package adds a controller with ``@CONTROLLERS.register("name")`` above a function ``(model, settings, ...)`` that
returns one, or by an entry point of the group ``slipangle.controllers``. Its further arguments are entries of
``[controller]``. In the same way ``@ESTIMATORS.register("name")``, or an entry point of ``slipangle.estimators``, adds
an estimator: a function of the controller's model.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal, Self

from slipangle.control.driver import Driver
from slipangle.control.followers.compensated import Compensated
from slipangle.control.followers.feedforward import FeedforwardFeedback
from slipangle.control.followers.followers import PathFollower, PurePursuit, Stanley
from slipangle.control.followers.preview_lqr import PreviewLQR
from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.mpc import MPC
from slipangle.errors import ConfigError
from slipangle.estimate.ekf import EKF
from slipangle.estimate.moving_horizon import MHE
from slipangle.fields import Whole
from slipangle.models.model import Model
from slipangle.models.ode import Parametrised
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime.backend import RealTime
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths import lane_change as manoeuvres
from slipangle.paths.path import Path
from slipangle.registry import Registry
from slipangle.units import deg
from slipangle.workflow.entries import Made, Weight, Within, of_kind
from slipangle.workflow.hints import called

_MANOEUVRES = {
    "iso3888-1": manoeuvres.double_lane_change,
    "iso3888-2": manoeuvres.obstacle_avoidance,
}


ESTIMATORS: Registry[Callable[..., Any]] = Registry("estimator", "slipangle.estimators")
"""What ``kind`` in a job's ``[estimator]`` may be: functions of the controller's model."""

ESTIMATORS.register("ekf")(Made(EKF, ("start", "free"), lambda model, **entries: EKF(start=model, **entries)))
ESTIMATORS.register("mhe")(Made(MHE, ("start", "free", "solver"), lambda model, **entries: MHE(start=model, **entries)))


@dataclass(frozen=True, kw_only=True)
class EstimatorSettings:
    """What tells the controller the state of its model from what is measured, one of `ESTIMATORS`.

    Parameters
    ----------
    kind : str
        What it is; see 'slipangle list estimators'. The table's other entries are those of the kind.
    entries : dict
        These, checked.
    """

    kind: str = "ekf"
    entries: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def from_table(cls, table: dict[str, Any], where: str) -> Self:
        """Entries of every estimator, and those of its kind."""
        return of_kind(cls, ESTIMATORS, table, where)


@dataclass(frozen=True, kw_only=True)
class ControllerSettings:
    """The controller, one of `CONTROLLERS` on one of the job's models, and its test.

    Parameters
    ----------
    model : str
        Name of the model that it knows the car by.
    kind : str
        What it is; see 'slipangle list controllers'. The table's other entries are those of the kind.
    manoeuvre : str
        What is driven.
    track : Path
        A track to drive in place of a manoeuvre: CSV of x, y and widths, or a CommonRoad scenario.
    a_y, a_x : float
        Largest accelerations of the speed profile on a track; ``v_x`` is then the largest speed. [m/s2]
    v_x : float
        Speed of the manoeuvre. [m/s]
    dt : float
        Time between two plans. [s]
    width : float
        Of the car, for the lanes. [m]
    cars : int
        Cars that differ from the model, on which the controller is tried; 0 for none.
    delta_max : float
        Largest angle of the road wheels. [deg]
    delta_rate_max : float
        Largest rate of that angle. [deg/s]
    entries : dict
        The table's other ones: the settings that the kind takes, checked.
    """

    model: str
    kind: str = "mpc"
    manoeuvre: Literal["iso3888-1", "iso3888-2", "lane-changes"] = "iso3888-1"
    track: FilePath | None = None
    a_y: Annotated[float, Within(0.1, 100, "m/s2")] = 4.0
    a_x: Annotated[float, Within(0.1, 100, "m/s2")] = 2.0
    v_x: Annotated[float, Within(1, 150, "m/s")] = 20.0
    dt: Annotated[float, Within(1e-3, 1, "s")] = 0.05
    width: Annotated[float, Within(0.02, 10, "m")] = 1.8
    cars: Annotated[int, Within(0, 10_000)] = 200
    delta_max: Annotated[float, Within(0.1, 90, "deg")] = 20.0
    delta_rate_max: Annotated[float, Within(0.1, 1e4, "deg/s")] = 60.0
    entries: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def from_table(cls, table: dict[str, Any], where: str) -> Self:
        """Entries of every controller, and those of its kind."""
        return of_kind(cls, CONTROLLERS, table, where, skip=2, every=False)


CONTROLLERS: Registry[Callable[..., Any]] = Registry("controller", "slipangle.controllers")
"""What ``kind`` in a job's ``[controller]`` may be: functions of the identified model and `ControllerSettings`."""


@CONTROLLERS.register("mpc")
def build_mpc(
    model: Model,
    wanted: ControllerSettings,
    *,
    solver: Literal["realtime", "ipopt"] | RealTime | Ipopt = "realtime",
    horizon: Annotated[int, Within(1, 200, "steps")] = 20,
    steps: tuple[Annotated[int, Within(1, 1000)], ...] = (),
    Q: dict[str, Weight] | None = None,
    S: dict[str, Weight] | None = None,
    R: Weights | None = None,
    terminal: Weights | None = None,
    corridor: Annotated[float, Within(0, 100, "m", open="low")] | None = None,
    slack: Weights | None = None,
    slack_linear: Weights | None = None,
    deadline: Annotated[float, Within(0, 10, "s", open="low")] | None = None,
    fallback: Whole = 5,
) -> MPC:
    """The predictive controller; its model is re-discretised at the controller's step where it is an ODE.

    Parameters
    ----------
    model, wanted
        The identified model and the table's common entries.
    solver : {"realtime", "ipopt"}
        The real-time one runs compiled; Ipopt is the reference to compare with.
    horizon : int
        Steps that it plans ahead.
    steps : tuple of int
        Length of each step of the horizon in steps of the controller; by default all are one.
    Q : table
        Weights of squared deviations, by name of what is tracked; by default X = 0.1, Y = 1, psi = 1.
    S : table
        Weights of squared changes of inputs, by name; by default delta = 50.
    R : table
        Weights of squared inputs, by name; by default none.
    terminal : table
        Weights of squared deviations at the end of the horizon, by name; by default those of ``Q``.
    corridor : float
        Width of the car that is kept between the path's boundaries; by default they do not count. [m]
    slack, slack_linear : table
        Weights of squared and of plain violations of what may be violated, by name.
    deadline : float
        Longest wall time of one plan; by default none. [s]
    fallback : int
        How many steps in a row the last plan may serve where a solve fails.
    """
    if isinstance(model, Parametrised) and {"v_y", "r"} <= set(model.states):
        model = model.resampled(wanted.dt, outputs=("v_y", "r"))
    elif not math.isclose(model.dt, wanted.dt, rel_tol=1e-6):
        raise _other_step(model, wanted)
    limit, rate = deg(wanted.delta_max), deg(wanted.delta_rate_max)
    return MPC(
        OnGround(model),
        horizon=horizon,
        steps=steps or None,
        controls=("delta",),
        R=R or Weights(),
        terminal=terminal,
        corridor=corridor,
        slack=slack or Weights(),
        slack_linear=slack_linear or Weights(),
        deadline=deadline,
        fallback=fallback,
        Q=Weights({"X": 0.1, "Y": 1.0, "psi": 1.0} if Q is None else Q),
        S=Weights({"delta": 50.0} if S is None else S),
        limits=Limits(delta=(-limit, limit)),
        rates=Limits(delta=(-rate, rate)),
        solver=solver,
    )


def _other_step(model: Model, wanted: ControllerSettings) -> ConfigError:
    return ConfigError(
        f"[controller] works at {wanted.dt:g} s, the model '{wanted.model}' was identified at {model.dt:g} s; "
        f"expected the same: set rate = {1 / wanted.dt:g} in [data] or dt = {model.dt:g} in [controller]"
    )


def build_path(wanted: ControllerSettings) -> Path:
    """The manoeuvre's path with its lanes, or the track's at the speed that its limits allow."""
    if wanted.track is not None:
        return Path.from_file(wanted.track).with_speed_limits(v_max=wanted.v_x, a_y=wanted.a_y, a_x=wanted.a_x)
    if wanted.manoeuvre == "lane-changes":
        return manoeuvres.lane_changes(wanted.v_x)
    return _MANOEUVRES[wanted.manoeuvre](wanted.v_x, width=wanted.width)


def _follower(law: type[PathFollower]) -> Made:
    """A path follower of an identified car, with the limits of the job."""

    def make(model: Model, wanted: ControllerSettings, **entries: Any) -> PathFollower:
        return _law_of(law, model, wanted, **entries)

    return Made(law, ("params", "dt", "limit", "rate"), make)


def _law_of(law: type[PathFollower], model: Model, wanted: ControllerSettings, **entries: Any) -> PathFollower:
    params = identified_bicycle(model)
    if params is None:
        raise _needs_car(wanted)
    at = params.at_speed(wanted.v_x)
    return law(params=at, dt=wanted.dt, limit=deg(wanted.delta_max), rate=deg(wanted.delta_rate_max), **entries)


def _needs_car(wanted: ControllerSettings) -> ConfigError:
    return ConfigError(
        f'[controller] kind = "{wanted.kind}" needs mass, geometry and cornering stiffness, and the model '
        f'\'{wanted.model}\' has none; expected one such as kind = "car" or "bicycle": name another model'
    )


def require_no_law(wanted: ControllerSettings) -> None:
    """Raise ConfigError if the controller is a path follower or holds one, which needs a model of a car."""
    if wanted.kind in _LAWS or (wanted.kind == "driver" and wanted.entries.get("law", "mpc") != "mpc"):
        raise _needs_car(wanted)


_LAWS: dict[str, type[PathFollower]] = {
    called(law): law for law in (PurePursuit, Stanley, FeedforwardFeedback, PreviewLQR)
}
for _name, _law in _LAWS.items():
    CONTROLLERS.register(_name)(_follower(_law))


def _multi_arx_mpc(model: Model, wanted: ControllerSettings, **entries: Any) -> MultiARXMPC:
    if not math.isclose(model.dt, wanted.dt, rel_tol=1e-6):
        raise _other_step(model, wanted)
    limit, rate = deg(wanted.delta_max), deg(wanted.delta_rate_max)
    posed: Any = model if tuple(model.outputs) == ("Y",) else OnGround(model)
    return MultiARXMPC(posed, limits=Limits(delta=(-limit, limit)), rates=Limits(delta=(-rate, rate)), **entries)


CONTROLLERS.register("multi-arx-mpc")(Made(MultiARXMPC, ("model", "limits", "rates"), _multi_arx_mpc))


@CONTROLLERS.register("driver")
def build_driver(
    model: Model,
    wanted: ControllerSettings,
    *,
    noise: dict[str, Weight] | None = None,
    late: dict[str, Annotated[float, Within(0, 10, "s")]] | None = None,
    law: Literal["mpc", "pure-pursuit", "stanley", "feedforward-feedback", "preview-lqr"] = "mpc",
) -> Driver:
    """From measurements to commands: an estimator, a controller and the path in one, see `Driver`.

    Parameters
    ----------
    model, wanted
        The identified model and the table's common entries; the limits of the steering are the driver's own with the
        predictive controller.
    noise : table
        Standard deviation of measured outputs, X, Y and psi among them, in the output's unit.
    late : table
        How long after its instant an output arrives. [s]
    law : str
        Who steers: the predictive controller, or a path follower that looks a second ahead, with delay and lag of the
        steering compensated and without steady error, see `Compensated`.
    """
    controller = None
    if law != "mpc":
        follower = _law_of(_LAWS[law], model, wanted, horizon=max(round(1.0 / wanted.dt), 1))
        controller = Compensated(follower=follower, car=model)
    return Driver(model, build_path(wanted), controller=controller, noise=noise, late=late, dt=wanted.dt)


def identified_bicycle(model: Model) -> BicycleParams | None:
    """Mass, geometry and stiffness that a model holds, also inside of a hybrid or behind other sensors; or None."""
    own = getattr(getattr(model, "params", None), "bicycle", None)
    own = own or getattr(getattr(model, "ode", None), "bicycle", None)
    inside = physics_in(model)
    return own if own or inside is None else identified_bicycle(inside)


def physics_in(model: Model) -> Model | None:
    """What a hybrid, or a model behind other sensors, is built on; None of others."""
    inside = getattr(model, "base", None) or getattr(model, "model", None)
    return inside if isinstance(inside, Model) else None
