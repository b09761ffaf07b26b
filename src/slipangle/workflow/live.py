"""The closed loop of a job for its page: what it used of its tires, a second controller, and the loop to drive oneself.

``SLIPANGLE_LIVE=none`` makes pages without the last, which takes a compiler some seconds.
"""

from __future__ import annotations

import os
import warnings
from typing import Any

import numpy as np

from slipangle import MPC, Run
from slipangle.control.driver import Driver
from slipangle.control.followers.feedforward import FeedforwardFeedback
from slipangle.errors import ModelWarning, SlipangleError
from slipangle.export.live import Live
from slipangle.export.live_driver import LiveDriver
from slipangle.report.playback import Beside, LiveDrive, Slider
from slipangle.simulate.loop import closed_loop
from slipangle.units import deg, read_in
from slipangle.workflow.controllers import ControllerSettings, EstimatorSettings, build_path, identified_bicycle
from slipangle.workflow.drive import PlantSettings, build_plant, whole_driver

_NAMED = {
    "X": "along X",
    "Y": "across",
    "psi": "of the heading",
    "e_y": "of the distance",
    "e_psi": "of the heading",
    "e_course": "of the course",
}


def tire_use(run: Run, rows: np.ndarray, plant_settings: PlantSettings, model: Any) -> list[list[float]]:
    """Tire forces over the available ones at some samples, along and across, front then rear; empty if not known."""
    model = None if plant_settings.kind else build_plant(plant_settings, model)[0].model
    if not getattr(model, "tells_tire_use", False):
        return []
    x = np.array([run[n][rows] for n in model.states])
    u = np.array([run[n][rows] for n in model.inputs])
    return np.array(model.tire_use(x, u)).T.tolist()


def other_law(wanted: ControllerSettings, plant_settings: PlantSettings, model: Any) -> Beside | None:
    """The same manoeuvre driven by a law that predicts nothing; None where the model is no car."""
    params = identified_bicycle(model)
    if params is None or wanted.kind == "feedforward-feedback" or plant_settings.kind:
        return None
    limits: Any = {"limit": deg(wanted.delta_max), "rate": deg(wanted.delta_rate_max)}
    law = FeedforwardFeedback(params=params.at_speed(wanted.v_x), dt=wanted.dt, **limits)
    try:
        plant, driver, _ = build_plant(plant_settings, model)
        run = closed_loop(plant, law, build_path(wanted), driver=driver, width=wanted.width)
    except SlipangleError:  # what it is compared to is worth no lost page
        return None
    rows = np.searchsorted(run.t, run.t_plan - 1e-9).clip(0, len(run.t) - 1)
    pose = {n: run[n][rows].tolist() for n in ("X", "Y", "psi")}
    return Beside(label="feed-forward and feedback", t=run.t[rows].tolist(), **pose)


def live_drive(
    wanted: ControllerSettings,
    plant_settings: PlantSettings,
    model: Any,
    controller: Any,
    estimator: EstimatorSettings | None = None,
) -> LiveDrive | None:
    """The job's loop as a program of the page; None where there is no compiler for it, or no place in a page."""
    whole = isinstance(controller, Driver)
    known = whole or (type(controller) is MPC and estimator is None)
    if not known or plant_settings.kind or os.environ.get("SLIPANGLE_LIVE", "").strip().lower() == "none":
        return None
    try:
        plant, speed, _ = build_plant(plant_settings, model)
        if speed is None:
            return None
        if whole:
            live: Live = LiveDriver(plant=plant, whole=whole_driver(controller, speed, estimator))
        else:
            live = Live(plant=plant, mpc=controller, path=build_path(wanted), driver=speed)
        with warnings.catch_warnings(action="ignore", category=ModelWarning):
            program = live.wasm()
    except SlipangleError:
        return None
    if program is None:
        return None
    mpc = live.mpc
    states = mpc.model.states
    place = len(states), mpc.horizon + 1, states.index("X"), states.index("Y")
    return LiveDrive(
        program=program, sliders=[_slider(s, live) for s in live.settings], row=live.row, dt=mpc.dt, state=place
    )


def _slider(setting: Any, live: Live) -> Slider:
    """A setting of the loop as people read it."""
    name, v_x = setting.name, float(np.max(np.asarray(live.path.v_x)))
    fast, speed = read_in("v_x", "m/s")
    shown: dict[str, tuple[str, float, str]] = {
        "pace": ("speed", fast * v_x, speed),
        "friction": ("friction of the road, 1 as the tires' own", 1.0, ""),
        "delay": ("delay of the steering", *read_in("delay", "s")),
        "mass": ("mass of the car", float(getattr(getattr(live.plant.model, "params", None), "mass", 1.0)), "kg"),
    }
    if name in shown:
        label, factor, unit = shown[name]
        ends = {n: factor * getattr(setting, n) for n in ("value", "low", "high")}
        return Slider(label=label, unit=unit, scale=1 / factor, **ends)
    of = name.removeprefix("weight ")
    change = of in live.mpc.controls
    weight = live.mpc.ocp.S[of] if change else live.mpc.ocp.Q.get(of, 0.0)
    label = "weight of changes of the steering" if change else f"weight {_NAMED.get(of, f'of {of}')}"
    if not weight:
        return Slider(label=label, value=1.0, low=1.0, high=1.0)
    return Slider(
        label=label, value=weight, low=setting.low * weight, high=setting.high * weight, scale=1 / weight, ratio=True
    )
