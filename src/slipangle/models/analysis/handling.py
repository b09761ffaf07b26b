"""`handling`: how a car answers its steering over speed, in the quantities of ISO 4138, ISO 7401 and ISO 13674."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from slipangle.errors import ParameterError, nearest
from slipangle.models.analysis.linearised import LinearisedModel
from slipangle.models.analysis.linearize import linearize
from slipangle.models.analysis.responses import Estimate
from slipangle.models.analysis.trim import STEERING
from slipangle.models.model import Model
from slipangle.numerics.critical import quantile
from slipangle.units import speed_said

_WEAVE = 0.2  # Hz, of the on-centre weave of ISO 13674-1
_LEVEL = 4.0  # m/s2, lateral acceleration at which ISO 7401 wants its step


@dataclass(frozen=True)
class Quantity:
    """What a standard calls a quantity, its unit, where it is defined."""

    title: str
    unit: str
    standard: str


QUANTITIES: Mapping[str, Quantity] = {
    "understeer_gradient": Quantity("understeer gradient", "rad/(m/s2)", "ISO 4138"),
    "yaw_gain": Quantity("yaw-rate gain, steady", "(rad/s)/rad", "ISO 4138"),
    "steering_sensitivity": Quantity("steering sensitivity, steady", "(m/s2)/rad", "ISO 4138"),
    "sideslip_gain": Quantity("side-slip gain, steady", "rad/rad", "ISO 4138"),
    "rise_time": Quantity("yaw-rate response time, step", "s", "ISO 7401"),
    "peak_time": Quantity("yaw-rate peak response time, step", "s", "ISO 7401"),
    "overshoot": Quantity("yaw-rate overshoot, step", "-", "ISO 7401"),
    "tb_factor": Quantity("TB factor at 4 m/s2", "rad s", "ISO 7401"),
    "natural_frequency": Quantity("natural frequency of the yaw motion", "rad/s", "linear model"),
    "damping": Quantity("damping ratio of the yaw motion", "-", "linear model"),
    "bandwidth": Quantity("yaw-rate bandwidth, -3 dB", "Hz", "ISO 7401"),
    "weave_yaw_gain": Quantity("yaw-rate gain at 0.2 Hz", "(rad/s)/rad", "ISO 13674-1"),
    "weave_yaw_lag": Quantity("yaw-rate lag at 0.2 Hz", "s", "ISO 13674-1"),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Handling:
    """Handling quantities over speed, see `QUANTITIES` for names, units and standards.

    Parameters
    ----------
    v_x : array, shape (n,)
        Speeds. [m/s]
    values, stds : mapping of str to array, shape (n,)
        Each quantity at each speed, and its standard deviation; NaN where it is not defined or not known.
    characteristic_speed, critical_speed : Estimate
        Of ISO 4138, by the understeer gradient at the first speed: where the yaw-rate gain of an understeering car is
        largest, where an oversteering car becomes unstable; infinite of the other kind of car. [m/s]
    """

    v_x: np.ndarray
    values: Mapping[str, np.ndarray]
    stds: Mapping[str, np.ndarray]
    characteristic_speed: Estimate
    critical_speed: Estimate
    name: str = "model"
    uncertainty: str = ""  # where the standard deviations come from, or why there are none

    def __getitem__(self, name: str) -> np.ndarray:
        """One quantity over speed, shape (n,); raises ParameterError if there is none of that name."""
        self._known(name)
        return self.values[name]

    def band(self, name: str, level: float = 0.95) -> np.ndarray:
        """Confidence band of one quantity, shape (n, 2)."""
        self._known(name)
        half = quantile(level) * self.stds[name]
        return np.column_stack([self.values[name] - half, self.values[name] + half])

    def _known(self, name: str) -> None:
        if name not in self.values:
            raise ParameterError(f"there is no quantity '{name}'; {nearest(name, self.values)}")

    def table(self, v_x: float | None = None) -> Any:
        """All quantities at the speed nearest to one [m/s], a `slipangle.report.Table`; by default the middle one."""
        return import_module("slipangle.report.linear").handling_table(self, v_x)  # a room above this one

    def plot(self, *names: str) -> Any:
        """Quantities over speed with their bands; a Plotly figure that shows in a notebook."""
        for name in names:
            self._known(name)
        return import_module("slipangle.report.linear").handling_curves((self,), names)  # a room above this one

    def __repr__(self) -> str:
        ends = f"{speed_said(self.v_x[0])} to {speed_said(self.v_x[-1])}"
        kind = "characteristic" if np.isfinite(self.characteristic_speed.value) else "critical"
        return f"<Handling of '{self.name}', {ends}: {kind} speed {getattr(self, f'{kind}_speed')}>"

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()


def handling(
    model: Model,
    *,
    v_x: Sequence[float] | np.ndarray = (10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0),
    a_y: float = 0.0,
    wheelbase: float | None = None,
    steering_gain: float | None = None,
    inputs: Mapping[str, float] | None = None,
    name: str = "",
) -> Handling:
    """Handling quantities of a model over speed, by name and standard, with confidence bands from its fit.

    Raises ParameterError if the model has no steering input or no yaw rate, or the wheelbase is not known.

    Parameters
    ----------
    model : Model
        Any with the input "delta" (or "delta_sw") and the output or state "r". Side slip and what follows from it need
        the state v_y.
    v_x : array, shape (n,)
        Speeds. [m/s]
    a_y : float
        Lateral acceleration around which the car is steered. [m/s2]
    wheelbase, steering_gain : float, optional
        By default the model's own: [m], and road-wheel angle per steering angle [-].
    inputs, name
        See `linearize`.
    """
    speeds = np.atleast_1d(np.asarray(v_x, dtype=float))
    steer = next((n for n in STEERING if n in model.inputs), None)
    ground = model.off_ground
    if steer is None or "r" not in (*ground.states, *ground.outputs):
        raise ParameterError(
            f"the {type(ground).__name__} has inputs {', '.join(model.inputs)} and outputs {', '.join(model.outputs)}; "
            "expected a steering input delta and the yaw rate r"
        )
    if speeds.ndim != 1 or not len(speeds) or not (np.isfinite(speeds).all() and (speeds > 0).all()):
        raise ParameterError("v_x holds no speeds or some that are not above 0; expected such as [10.0, 20.0, 30.0]")
    L = parameter_of(model, "wheelbase", wheelbase)
    if L is None:
        raise ParameterError(f"the {type(ground).__name__} has no wheelbase; expected it: wheelbase=2.7 [m]")
    ratio = parameter_of(model, "steering_gain", steering_gain)
    by_speed = "v_x" in (*ground.states, *ground.inputs)
    linear = [
        linearize(
            model,
            v_x=float(v) if by_speed else None,
            a_y=a_y,
            inputs=inputs,
            outputs=("r", *(("v_y",) if "v_y" in (*ground.states, *ground.outputs) else ())),
            name=name,
        )
        for v in speeds
    ]
    chosen = {"steer": steer, "wheelbase": L, "ratio": 1.0 if ratio is None else ratio}
    rows = [one.estimate(partial(_quantities, v_x=float(v), **chosen)) for one, v in zip(linear, speeds, strict=True)]
    values = {n: np.array([row[k].value for row in rows]) for k, n in enumerate(QUANTITIES)}
    stds = {n: np.array([row[k].std for row in rows]) for k, n in enumerate(QUANTITIES)}
    characteristic, critical = _special_speeds(rows[0][0], L)
    return Handling(
        v_x=speeds,
        values=values,
        stds=stds,
        characteristic_speed=characteristic,
        critical_speed=critical,
        name=linear[0].name,
        uncertainty=linear[0].uncertainty,
    )


def parameter_of(model: Any, name: str, given: float | None) -> float | None:
    """A parameter as given, or the model's own."""
    if given is not None:
        if not (np.isfinite(given) and given != 0 and (given > 0 or name != "wheelbase")):
            raise ParameterError(f"{name} is {given:g}; expected a number other than 0, a wheelbase above 0")
        return float(given)
    for place in _inside(model):
        own = getattr(getattr(place, "params", None), name, None)
        if own is not None:
            return float(own)
    return None


def _inside(model: Any) -> Iterator[Any]:
    """The model and what is wrapped in it."""
    while model is not None:
        yield model
        model = getattr(model, "base", None) or getattr(model, "model", None)


def _special_speeds(K: Estimate, wheelbase: float) -> tuple[Estimate, Estimate]:
    """Characteristic and critical speed of ISO 4138 from the understeer gradient."""
    none = Estimate(float("inf"), float("nan"), "m/s")
    if K.value == 0 or not np.isfinite(K.value):
        return none, none
    v = float(np.sqrt(wheelbase / abs(K.value)))
    found = Estimate(v, v / 2 * K.std / abs(K.value), "m/s")
    return (found, none) if K.value > 0 else (none, found)


def _quantities(model: LinearisedModel, v_x: float, steer: str, wheelbase: float, ratio: float) -> np.ndarray:
    """`QUANTITIES` of one linear model, in their order; NaN where one is not defined."""
    nan = float("nan")
    yaw = model.gain("r", steer).value
    step = model.step("r", steer)
    slip = model.gain("v_y", steer).value / v_x if "v_y" in model.outputs else nan
    place = 0, model.outputs.index("r"), model.inputs.index(steer)
    weave = model.frequency_response(np.array([2 * np.pi * _WEAVE]))[place]
    slow = _yaw_motion(model)
    square = float(np.prod(slow).real) if len(slow) == 2 else nan  # negative where one of two poles grows: no frequency
    frequency = square**0.5 if square > 0 else nan
    good = model.stable
    peak = step.peak_time if good else nan
    return np.array(
        [
            ratio / (v_x * yaw) - wheelbase / v_x**2,
            yaw,
            v_x * yaw,
            slip,
            step.rise_time if good else nan,
            peak,
            step.overshoot if good else nan,
            peak * slip * _LEVEL / (v_x * yaw),
            frequency,
            float(-slow.real.sum() / (2 * frequency)),
            _bandwidth(model, steer, yaw) if good else nan,
            abs(weave),
            -float(np.angle(weave * np.sign(yaw))) / (2 * np.pi * _WEAVE),
        ]
    )


def _yaw_motion(model: LinearisedModel) -> Any:
    """The two poles that v_y and r take part in most, as rates [rad/s]; of a black box the two slowest."""
    values, vectors = np.linalg.eig(model.A)
    rates = model.rates_of(values.astype(complex))
    weight = -np.abs(rates)
    if {"v_y", "r"} <= {*model.states} and np.linalg.cond(vectors) < 1e10:
        rows = [model.states.index(n) for n in ("v_y", "r")]
        weight = np.abs(vectors[rows] * np.linalg.inv(vectors).T[rows]).sum(axis=0)
    chosen = np.argsort(-np.where(np.isfinite(rates), weight, -np.inf), kind="stable")[:2]
    return rates[chosen] if np.isfinite(rates[chosen]).all() else rates[:0]


def _bandwidth(model: LinearisedModel, steer: str, steady: float) -> float:
    """Lowest frequency at which the yaw-rate gain has fallen by 3 dB. [Hz]"""
    i, j = model.outputs.index("r"), model.inputs.index(steer)
    top = min(50.0, 0.5 / model.dt) if model.dt else 50.0
    f = np.geomspace(0.01, top, 400)
    low = np.log(np.abs(model.frequency_response(2 * np.pi * f)[:, i, j] / steady)) + 0.5 * np.log(2)
    if not (low < 0).any() or low[0] < 0:
        return float("nan")
    k = int(np.argmax(low < 0))
    a, b = low[k - 1], low[k]
    return float(np.exp(np.interp(0.0, [-a, -b], np.log(f[k - 1 : k + 1]))))
