"""`handling_diagram`: how much steering a car needs the harder it corners, up to its limit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from slipangle.errors import ParameterError
from slipangle.models.analysis.handling import parameter_of
from slipangle.models.analysis.linearised import SHARE
from slipangle.models.analysis.linearize import directions
from slipangle.models.analysis.trim import STEERING, Motion, Trim, moving
from slipangle.models.model import Model
from slipangle.numerics.critical import quantile
from slipangle.units import speed_said

_HALVINGS = 12  # of the last step, at whose end there is no steady state any more


@dataclass(frozen=True, kw_only=True, eq=False)
class HandlingDiagram:
    """Steady cornering at one speed over lateral acceleration, see `handling_diagram`.

    Parameters
    ----------
    v_x : float
        Speed. [m/s]
    a_y : array, shape (n,)
        Lateral acceleration ``v_x r``, rising from 0. [m/s2]
    delta, understeer_angle, understeer_gradient, beta : array, shape (n,)
        Road-wheel angle beyond that of straight driving [rad]; what of it is more than ``wheelbase a_y / v_x^2``, the
        difference of the axles' slip angles [rad]; its slope [rad/(m/s2)]; side slip angle, NaN where the model has no
        v_y. [rad]
    understeer_angle_std : array, shape (n,)
        Standard deviation from the fit; NaN where not known. [rad]
    stable : array of bool, shape (n,)
        Whether the car stays there by itself with the steering held.
    a_y_max : float
        Largest lateral acceleration with a steady state; infinite where the diagram ended before. [m/s2]
    uncertainty : str
        Where the standard deviation comes from, or why there is none.
    """

    v_x: float
    a_y: np.ndarray
    delta: np.ndarray
    understeer_angle: np.ndarray
    understeer_gradient: np.ndarray
    beta: np.ndarray
    understeer_angle_std: np.ndarray
    stable: np.ndarray
    a_y_max: float
    name: str = "model"
    uncertainty: str = ""

    def band(self, level: float = 0.95) -> np.ndarray:
        """Confidence band of the understeer angle, shape (n, 2). [rad]"""
        half = quantile(level) * self.understeer_angle_std
        return np.column_stack([self.understeer_angle - half, self.understeer_angle + half])

    @property
    def limit(self) -> str:
        """How the car goes over its limit: "understeer", "oversteer", or "" where the diagram ended before."""
        if not np.isfinite(self.a_y_max):
            return ""
        return "understeer" if self.understeer_gradient[-1] > self.understeer_gradient[0] else "oversteer"

    def table(self) -> Any:
        """The diagram at a few lateral accelerations, a `slipangle.report.Table`."""
        return import_module("slipangle.report.stability").diagram_table(self)  # a room above this one

    def plot(self, *others: HandlingDiagram) -> Any:
        """Understeer angle over lateral acceleration with its band, others laid over; a Plotly figure."""
        return import_module("slipangle.report.stability").diagram_figure((self, *others))  # a room above this one

    def __repr__(self) -> str:
        end = f"limit {self.a_y_max:.3g} m/s2, {self.limit}" if self.limit else f"no limit to {self.a_y[-1]:.3g} m/s2"
        return f"<HandlingDiagram of '{self.name}' at {speed_said(self.v_x)}: {end}>"

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()


def handling_diagram(
    model: Model,
    *,
    v_x: float,
    a_y: float = 12.0,
    points: int = 41,
    wheelbase: float | None = None,
    steering_gain: float | None = None,
    inputs: Mapping[str, float] | None = None,
    name: str = "",
) -> HandlingDiagram:
    """Handling diagram: steady cornering at one speed, from straight driving to the limit.

    The understeer angle ``steering_gain (delta - delta_0) - wheelbase a_y / v_x^2`` is the difference of the slip
    angles of front and rear axle ([1]_ sec. 1.3.3); its slope at small a_y is the understeer gradient of ISO 4138, its
    bend what saturating tires make of it. A linear car's is a straight line without a limit.

    Raises ParameterError if the model does not steer, has no yaw rate or no speed, or the wheelbase is not known.

    Parameters
    ----------
    model : Model
        Any with the input "delta" (or "delta_sw"), the speed v_x and the yaw rate.
    v_x : float
        Speed. [m/s]
    a_y : float
        Largest lateral acceleration to look at. [m/s2]
    points : int
        How many lateral accelerations, at least 5.
    wheelbase, steering_gain : float, optional
        By default the model's own: [m], and road-wheel angle per steering angle [-].
    inputs, name
        See `linearize`.

    For example ``sa.handling_diagram(car, v_x=20.0).plot()``.

    References
    ----------
    .. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 1.3.3.
    """
    ground = model.off_ground
    steer = next((n for n in STEERING if n in ground.inputs), None)
    if steer is None or "r" not in (*ground.states, *ground.outputs):
        raise ParameterError(
            f"the {type(ground).__name__} has inputs {', '.join(ground.inputs)} and outputs "
            f"{', '.join(ground.outputs)}; expected a steering input delta and the yaw rate r"
        )
    L = parameter_of(model, "wheelbase", wheelbase)
    if L is None:
        raise ParameterError(f"the {type(ground).__name__} has no wheelbase; expected it: wheelbase=2.7 [m]")
    if not (np.isfinite(a_y) and a_y > 0 and points >= 5):
        raise ParameterError(f"a_y is {a_y:g} m/s2 and points {points}; expected a_y above 0 and at least 5 points")
    gain = parameter_of(model, "steering_gain", steering_gain)
    gain = 1.0 if gain is None else gain
    info, adjustable = ground.fit_info, getattr(ground, "parameter_names", ())
    names = tuple(n for n in info.names if n in adjustable) if info is not None else ()
    motion = Motion(ground, names)
    given, p = inputs or {}, motion.values
    row = ground.inputs.index(steer)
    trims = _cornering(motion, v_x, float(a_y), points, given)
    at = np.array([t.a_y for t in trims])
    if len(at) < 3:
        raise ParameterError(f"the {type(ground).__name__} corners at no a_y at {v_x:g} m/s; expected another speed")
    said, roots = directions(ground, names)
    squares = np.zeros(len(trims))
    for d in roots:
        ends = [[_moved(motion, t, given, p + sign * SHARE * d).u[row] for t in trims] for sign in (1, -1)]
        slope = (np.array(ends[0]) - np.array(ends[1])) / (2 * SHARE)
        squares += (gain * (slope - slope[0])) ** 2
    delta = gain * (np.array([t.u[row] for t in trims]) - trims[0].u[row])
    extra = delta - L * at / v_x**2
    slip = np.full(len(at), np.nan)
    if "v_y" in ground.states:
        slip = np.arctan2([t.x[ground.states.index("v_y")] for t in trims], v_x)
    return HandlingDiagram(
        v_x=float(v_x),
        a_y=at,
        delta=delta,
        understeer_angle=extra,
        understeer_gradient=np.asarray(np.gradient(extra, at, edge_order=2)),
        beta=slip,
        understeer_angle_std=np.sqrt(squares) if len(roots) else np.full(len(at), np.nan),
        stable=np.array([_stays(motion, t, p) for t in trims]),
        a_y_max=float(at[-1]) if at[-1] < a_y * (1 - 1e-9) else float("inf"),
        name=name or type(ground).__name__,
        uncertainty=said,
    )


def _cornering(motion: Motion, v_x: float, most: float, points: int, given: Mapping[str, float]) -> list[Trim]:
    """Steady states from straight driving to the largest lateral acceleration [m/s2] that has one, at most ``most``."""
    found = [motion.trim(v_x, 0.0, given, motion.values)]
    step = most / (points - 1)
    while found[-1].a_y < most * (1 - 1e-9) and step >= most / (points - 1) / 2**_HALVINGS:
        try:
            found.append(motion.trim(v_x, min(found[-1].a_y + step, most), given, motion.values, near=found[-1]))
        except ParameterError:  # no steady state there: the limit is closer
            step /= 2
    return found


def _moved(motion: Motion, near: Trim, given: Mapping[str, float], p: np.ndarray) -> Trim:
    """The steady state with other parameters; NaN where these have none."""
    try:
        return motion.trim(near.v_x, near.a_y, given, p, near=near)
    except ParameterError:
        return Trim(x=np.full_like(near.x, np.nan), u=np.full_like(near.u, np.nan), v_x=near.v_x, a_y=near.a_y)


def lateral_states(motion: Motion) -> np.ndarray:
    """Rows of the states that move while speed, position and heading are left out."""
    left = {*moving(motion.model), "v_x"}
    return np.array([i for i, n in enumerate(motion.model.states) if n not in left], dtype=int)


def _stays(motion: Motion, trim: Trim, p: np.ndarray) -> bool:
    """Whether all motions beside a steady state die out at a held speed."""
    rows = lateral_states(motion)
    values = np.linalg.eigvals(motion.slopes(trim.x, trim.u, p)[1][np.ix_(rows, rows)])
    return bool((np.abs(values) < 1).all() if motion.dt else (values.real < 0).all())
