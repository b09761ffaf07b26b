"""What of a car's grip a drive uses: g-g diagram, tire forces used and available."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.errors import ParameterError
from slipangle.optimal.lap.car import LapCar, forces
from slipangle.optimal.lap.cars import grip_of
from slipangle.optimal.lap.envelope import envelope
from slipangle.report.style import (
    BLUE,
    INK,
    SLATE,
    VERMILION,
    axes,
    dots,
    escape,
    largest,
    line,
    new_figure,
    on_one_axis,
    series_style,
    thin,
    with_gaps,
)
from slipangle.report.tables import Heading, Row, Table
from slipangle.units import speed_said

_NO_LOG = "the log is a", "it comes before the car; of a car alone say sa.gg_diagram(car=car)"
_SLOWEST = 3.0  # m/s


# ---- g-g diagram ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class GGDiagram:
    """Accelerations of a log, of a car's limits, or both, see `gg_diagram`.

    Parameters
    ----------
    a_x, a_y : array, shape (n,)
        Of the log, along and across the car; empty without one. [m/s2]
    v : array, shape (m,)
        Speeds of the limits; empty without a car. [m/s]
    limits : tuple of array, each of shape (k, 2)
        Closed curve of a_y and a_x at each speed. [m/s2]
    name, log_name : str
        Of car and log.
    """

    a_x: np.ndarray
    a_y: np.ndarray
    v: np.ndarray
    limits: tuple[np.ndarray, ...]
    name: str = "car"
    log_name: str = "log"

    def table(self) -> Any:
        """Largest accelerations, a `slipangle.report.Table`: those 1 % of the log exceed, the car's at each speed."""
        rows = []
        if len(self.a_y):
            ends = [np.percentile(v, 99) for v in (np.abs(self.a_y), self.a_x, -self.a_x)]
            rows.append(Row((f"{self.log_name}, 99 % of samples", *(float(e) for e in ends))))
        for v, edge in zip(self.v, self.limits, strict=True):
            named = f"{self.name} at {speed_said(v)}"
            rows.append(Row((named, float(edge[:, 0].max()), float(edge[:, 1].max()), float(-edge[:, 1].min()))))
        heads = (Heading(n, "m/s2") for n in ("lateral", "driving", "braking"))
        return Table(title="Largest accelerations", columns=(Heading("", words=True), *heads), rows=tuple(rows))

    def plot(self) -> go.Figure:
        """Longitudinal over lateral acceleration; a Plotly figure that shows in a notebook."""
        figure = new_figure(520, hovermode="closest")
        if len(self.a_y):
            rows = np.unique(np.concatenate([largest(v, 1500) for v in (self.a_x, self.a_y)]))
            dots(figure, self.a_y[rows], self.a_x[rows], SLATE, 3, name=escape(self.log_name), marker={"opacity": 0.5})
        for k, (v, edge) in enumerate(zip(self.v, self.limits, strict=True)):
            colour, dash = series_style(k)
            hover = f"{speed_said(v)}: %{{x:.3g}} across, %{{y:.3g}} m/s² along"
            name = escape(f"{self.name}, {speed_said(v)}")
            line(figure, edge[:, 0], edge[:, 1], colour, 2, dash=dash, name=name, hovertemplate=hover)
        across = {"zeroline": True, "zerolinecolor": SLATE.light}
        equal = {**across, "scaleanchor": "x"}
        x, y = "lateral acceleration a_y [m/s²]", "longitudinal acceleration a_x [m/s²]"
        return axes(figure, x, y, xaxis=across, yaxis=equal)

    def __repr__(self) -> str:
        said = [f"{len(self.a_y)} samples of '{self.log_name}'"] if len(self.a_y) else []
        said += [f"limits of '{self.name}' at {', '.join(speed_said(v) for v in self.v)}"] if len(self.v) else []
        return f"<GGDiagram: {'; '.join(said)}>"

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()


def gg_diagram(
    data: Dataset | None = None,
    car: Any = None,
    *,
    v_x: Sequence[float] | None = None,
    name: str = "",
) -> GGDiagram:
    """g-g diagram: accelerations along and across the car, of a log, of a car's limits, or the log inside the limits.

    The limits are quasi-steady: both axles balance the car's yaw inside their friction ellipses, under load transfer,
    downforce and drag, and use 98 % of their longitudinal force, as a fastest lap does ([1]_;
    `slipangle.optimal.lap.envelope.envelope`). Where the power of the engine is not known,
    the tires alone bound the driving side. Accelerations that are no channels of the log follow from its motion:
    ``a_x = dv_x/dt - v_y r`` and ``a_y = dv_y/dt + v_x r``, with v_y zero where it was not measured.

    Raises ParameterError without a log and a car, if the log has neither accelerations nor v_x and r, or the car does
    not know what its tires can hold.

    Parameters
    ----------
    data : Dataset, optional
        The log.
    car : Model or LapCar, optional
        See `slipangle.lap_car`.
    v_x : sequence of float, optional
        Speeds of the limits; by default the middle one of the log, or 20 m/s. [m/s]
    name : str, optional
        Of the car, for figures.

    For example ``sa.gg_diagram(data, model).plot()``.

    References
    ----------
    .. [1] W. F. Milliken, D. L. Milliken, Race Car Vehicle Dynamics, 1995, ch. 9.
    """
    if data is None and car is None:
        raise ParameterError("there is neither a log nor a car; expected at least one: sa.gg_diagram(data, model)")
    along, across = (np.empty(0), np.empty(0)) if data is None else accelerations(data)
    speeds, edges = np.empty(0), ()
    if car is not None:
        usual = 20.0 if data is None or "v_x" not in data else max(_SLOWEST, float(np.median(data["v_x"])))
        speeds = np.array([usual] if v_x is None else v_x, dtype=float)
        if speeds.ndim != 1 or not len(speeds) or not (np.isfinite(speeds).all() and (speeds > 0).all()):
            raise ParameterError("v_x holds no speeds or some that are not above 0; expected such as [15.0, 30.0]")
        edges = tuple(_edge(grip_of(car), float(v)) for v in speeds)
    given = getattr(car, "model", car)
    return GGDiagram(
        a_x=along,
        a_y=across,
        v=speeds,
        limits=edges,
        name=name or (type(given).__name__ if car is not None else ""),
        log_name="" if data is None else data.name,
    )


def _edge(car: LapCar, v: float) -> np.ndarray:
    """Closed curve of a_y and a_x at a speed: driving to the left, then back by braking, and the same to the right."""
    found = envelope(car, v, speeds=2, shares=31)
    a_y = found.a_y[-1] * found.share
    half = np.concatenate([np.column_stack([a_y, found.drive[-1]]), np.column_stack([a_y, -found.brake[-1]])[::-1]])
    other = half[::-1] * [-1.0, 1.0]
    return np.concatenate([half, other, half[:1]])


def accelerations(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """a_x and a_y of a log, measured or from its motion, shapes (n,). [m/s2]"""
    require_dataset(data, *_NO_LOG)
    if "a_x" in data and "a_y" in data:
        return data["a_x"], data["a_y"]
    missing = [n for n in ("v_x", "r") if n not in data]
    if missing:
        raise ParameterError(
            f"'{data.name}' has no {' and no '.join(missing)}; expected a_x and a_y, or v_x and r, among its channels"
        )
    rows: list[list[np.ndarray]] = [[], []]
    for part in data.experiments:
        v_x, r = part["v_x"], part["r"]
        v_y = part["v_y"] if "v_y" in part else np.zeros(len(r))
        slow = [np.gradient(v, part.dt) if len(v) > 1 else np.zeros(len(v)) for v in (v_x, v_y)]
        rows[0].append(slow[0] - v_y * r)
        rows[1].append(slow[1] + v_x * r)
    found = [np.concatenate(r) for r in rows]
    return (data["a_x"] if "a_x" in data else found[0]), (data["a_y"] if "a_y" in data else found[1])


# ---- tire forces ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class TireUse:
    """Forces of the axles over a drive and what their tires could hold, see `tire_use`.

    Parameters
    ----------
    t, starts
        Time of the samples [s], shape (n,), and the first sample of each experiment.
    F_y_f, F_y_r, F_x_f, F_x_r : array, shape (n,)
        Lateral and longitudinal forces of the axles. [N]
    available_f, available_r : array, shape (n,)
        Largest lateral force of each axle at its load then. [N]
    used_f, used_r : array, shape (n,)
        Force over what is available, along and across together: 1 at the friction ellipse, more where the car's
        parameters are too low. [-]
    """

    t: np.ndarray
    starts: tuple[int, ...]
    F_y_f: np.ndarray
    F_y_r: np.ndarray
    F_x_f: np.ndarray
    F_x_r: np.ndarray
    available_f: np.ndarray
    available_r: np.ndarray
    used_f: np.ndarray
    used_r: np.ndarray
    name: str = "log"

    def table(self) -> Any:
        """How much of its grip each axle used, a `slipangle.report.Table`: median, one sample in twenty, largest."""
        rows = []
        for axle, used in (("front", self.used_f), ("rear", self.used_r)):
            rows.append(Row((axle, *(100 * float(q) for q in np.percentile(used, [50, 95, 100])))))
        heads = (Heading(n, "%") for n in ("median", "95th percentile", "largest"))
        title = f"Grip used in {self.name}"
        return Table(title=title, columns=(Heading("axle", words=True), *heads), rows=tuple(rows))

    def plot(self) -> go.Figure:
        """Forces used over time, what is available around them, and the share; a Plotly figure."""
        figure, (t, title) = new_figure(560, hovermode="x unified"), on_one_axis(self.t, self.starts)
        parts = ((self.F_y_f, self.available_f, "y", "front"), (self.F_y_r, self.available_r, "y2", "rear"))
        for (used, most, axis, axle), colour in zip(parts, (BLUE, VERMILION), strict=True):
            first = axle == "front"
            x, there = with_gaps(t, most, self.starts)
            for sign in (1, -1):
                rows = thin(there, 1500)
                named: dict[str, Any] = {"name": "available", "showlegend": first and sign == 1, "yaxis": axis}
                line(figure, x[rows], sign * there[rows] / 1e3, INK, 1, dash="dot", **named)
            x, force = with_gaps(t, used, self.starts)
            rows = thin(force)
            line(
                figure,
                x[rows],
                force[rows] / 1e3,
                colour,
                name=f"{axle} axle",
                yaxis=axis,
                hovertemplate="%{y:.3g} kN",
            )
        for used, colour in ((self.used_f, BLUE), (self.used_r, VERMILION)):
            x, share = with_gaps(t, used, self.starts)
            rows = thin(share)
            line(figure, x[rows], 100 * share[rows], colour, showlegend=False, yaxis="y3", hovertemplate="%{y:.3g} %")
        more: dict[str, Any] = {
            "yaxis2": {"title": {"text": "rear F_y [kN]"}, "domain": [0.36, 0.66]},
            "yaxis3": {"title": {"text": "grip used [%]"}, "domain": [0.0, 0.3], "rangemode": "tozero"},
        }
        return axes(figure, title, "front F_y [kN]", xaxis={"anchor": "y3"}, yaxis={"domain": [0.7, 1.0]}, **more)

    def __repr__(self) -> str:
        ends = (f"{axle} {100 * used.max():.0f} %" for axle, used in (("front", self.used_f), ("rear", self.used_r)))
        return f"<TireUse of '{self.name}': at most {', '.join(ends)}>"

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()


def tire_use(data: Dataset, car: Any) -> TireUse:
    """Forces of both axles in a drive, and what their tires could hold.

    The forces follow from the motion by Newton and Euler, whatever the tires are: ``F_y_f = (mass l_r a_y + inertia_z
    r') / wheelbase``, ``F_y_r = (mass l_f a_y - inertia_z r') / wheelbase``, along the car ``mass a_x`` and drag,
    shared as the car drives and brakes. What is available is the car's: peak friction at the load of each tire, after
    load transfer and downforce. The share used is that of the friction ellipse ([1]_ sec. 1.2.3). Rates of change are
    central differences: filter a noisy log first. The moment of a locked axle counts as one of these forces.

    Raises ParameterError if the log has no v_x and r, or the car does not know what its tires can hold.

    Parameters
    ----------
    data : Dataset
        The drive: v_x and r, better with a_x, a_y, or v_y; see `gg_diagram`.
    car : Model or LapCar
        See `slipangle.lap_car`.

    For example ``sa.tire_use(data, model).plot()``.

    References
    ----------
    .. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012.
    """
    require_dataset(data, *_NO_LOG)
    missing = [n for n in ("v_x", "r") if n not in data]
    if missing:
        raise ParameterError(f"'{data.name}' has no {' and no '.join(missing)}; expected v_x and r among its channels")
    p = grip_of(car)
    a_x, a_y = accelerations(data)
    spin = np.concatenate([np.gradient(d["r"], d.dt) if len(d) > 1 else np.zeros(len(d)) for d in data.experiments])
    front = (p.mass * p.l_r * a_y + p.inertia_z * spin) / p.wheelbase
    rear = (p.mass * p.l_f * a_y - p.inertia_z * spin) / p.wheelbase
    v = np.asarray(data["v_x"], dtype=float)
    resistance = np.asarray(p.resistance(v), dtype=float)
    acting = forces(0.0, 0.0, p.mass * a_x + resistance, a_y, v, p)
    peaks = [np.asarray(axle.peak, dtype=float) for axle in (acting.front, acting.rear)]
    along = [np.asarray(axle.use, dtype=float) for axle in (acting.front, acting.rear)]
    used = [np.hypot(F / most, x) for F, most, x in zip((front, rear), peaks, along, strict=True)]
    return TireUse(
        t=data.t,
        starts=data.starts,
        F_y_f=front,
        F_y_r=rear,
        F_x_f=np.asarray(acting.F_xf, dtype=float),
        F_x_r=np.asarray(acting.F_xr, dtype=float),
        available_f=peaks[0],
        available_r=peaks[1],
        used_f=used[0],
        used_r=used[1],
        name=data.name,
    )
