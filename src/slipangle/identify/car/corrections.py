"""What a log may need beyond the linear bicycle, one correction after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.recordings import recordings
from slipangle.models.vehicles.load_transfer import LoadTransfer
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.vehicles.saturating_bicycle import RelaxingBicycle, SaturatingBicycleParams
from slipangle.models.vehicles.steering import Steered

DOWNFORCE = ("downforce_f", "downforce_r")
LOCKED = ("locked_half_track",)
LEVER = ("lever_v_y",)
SCALE = ("gain_v_y",)
SPEED = ("gain_v_x",)
REAR = ("gain_delta_r",)
RATE = ("steering_rate",)
LOADS = ("height", "load_lag", "drive_rear", "brake_rear")
_STOOD_IN = {"lever_v_y": 0.0, "gain_v_y": 1.0}  # for a locked axle
_FAR = ("steering_gain", "bias_r")  # what a log may show to be far from where it was said to be
_LATE = {"delay_delta": 0.05, "steering_lag": 0.05}  # s, where a search that begins at none may never come to
_SHARES = (1.1, 2.0)  # friction where its search starts, over the friction that was used
SLIDES = 0.6  # of gravity, lateral acceleration from which any tire's curve bends visibly
_RATES = (0.5, 0.2)  # limit of the steering's rate where its search starts, over the fastest that was steered
SLOW, FAST = 0.05, 0.95  # quantiles of the speeds that were driven
_UNLIKE = 1.4  # fast over slow driving, from which downforce can be told
_BRAKES, _OVER = 0.05, 0.5  # change of speed over gravity, from which loads shift, and s over which it is told
_SESSION = 28.0  # s of driving to fit to, mean of several recordings that may have offsets of their own; of 40 s about


@dataclass(frozen=True)
class Correction:
    """Something that a log may need: its name, its parameters, and where these start, in one or several places."""

    said: str
    free: tuple[str, ...]
    starts: tuple[Mapping[str, float], ...] = ({},)
    own: tuple[str, ...] = ()  # of `free`, those with a value for each recording
    around: Callable[[Any], Any] = lambda model: model  # what makes the car one that has them
    instead: Mapping[str, float] = field(default_factory=dict)  # what may have stood in for it, at none
    beside: tuple[str, ...] = ()  # parameters without which there is no such thing
    ordinary: bool = False  # whether every car has it, and the log goes where it shows
    constant: bool = False  # whether it is the same all the time, so that it helps on every stretch or is none

    def adds_nothing_to(self, free: tuple[str, ...], own: tuple[str, ...]) -> bool:
        """Whether its parameters are ``free`` with one value already, or in ``own`` those of each recording."""
        has = {*own} | ({*free} - {*self.own})
        return {*self.free} <= has or not {*self.beside} <= {*free, *own}


def corrections(
    data: Dataset, wheelbase: float, own: tuple[str, ...] | None, elsewhere: Mapping[str, float] | None = None
) -> tuple[Correction, ...]:
    """Corrections in the order in which they are tried; each stays if it helps on held-out stretches.

    ``own`` are parameters that have a value for each recording anyway; None lets offsets be tried so. ``elsewhere`` is
    where the gain and the yaw rate's bias, then tried first, start too, as where a sign or unit is another than was
    said or a sensor was not zeroed, with the tires' stiffness there.
    """
    biases = tuple(f"bias_{name}" for name in data.outputs)
    used = friction_used(data)
    mu = SaturatingBicycleParams.metadata()["mu_f"]  # wrong units may go beyond any friction
    starts = (float(np.clip(share * used, mu.lower, mu.upper)) for share in _SHARES)
    frictions = tuple({"mu_f": start, "mu_r": start} for start in starts)
    length, fastest = 0.1 * wheelbase, fastest_steering(data, 0.99)
    listed = [
        Correction("the steering's delay and lag are free", tuple(_LATE), ({}, _LATE), around=_steered),
        Correction("the steering's gain is free", ("steering_gain",)),
        Correction("the axles saturate", ("mu_f", "mu_r"), frictions, ordinary=used > SLIDES),
        Correction("the shape of the tire curves is free", ("shape",)),
        Correction(
            "the steering's rate has a limit",
            RATE,
            tuple({"steering_rate": share * fastest, "steering_lag": 0.05} for share in _RATES),
            beside=("steering_lag",),
        ),
        Correction("the sensors' biases are free", biases, constant=True),
        Correction(
            "the tires' relaxation lengths are free",
            ("relaxation_f", "relaxation_r"),
            ({"relaxation_f": length, "relaxation_r": length},),
            around=_relaxing,
        ),
    ]
    if "v_y" in data.outputs:
        listed.insert(-1, Correction("the place of the v_y sensor is free", LEVER))
        listed.insert(-1, Correction("the scale of the v_y sensor is free", SCALE))
    if "a_y" in data.outputs:
        listed.insert(-1, Correction("place and scale of the a_y sensor are free", ("lever_a_y", "gain_a_y")))
    if {"v_y", "a_y"} & {*data.outputs}:
        listed.append(
            Correction("the rear wheels turn as one", LOCKED, ({LOCKED[0]: 0.25 * wheelbase},), instead=_STOOD_IN)
        )
    if _brakes(data):
        listed.insert(3, Correction("braking shifts loads and takes grip", LOADS, around=_loaded))
    if "delta_r" in data.inputs:
        listed.append(Correction("the scale of delta_r is free", REAR))
    slow, fast = np.quantile(data["v_x"], (SLOW, FAST))
    if fast > _UNLIKE * slow:
        listed.append(Correction("the axles' loads grow with speed squared", DOWNFORCE))
    if own is None and _sessions(data):
        differ = (("the steering's offset differs", ("steering_offset",)), ("the sensors' biases differ", biases))
        listed += [
            Correction(f"{what} between recordings", names, own=names, constant=names == biases)
            for what, names in differ
        ]
    if elsewhere:
        first = [c for c in listed if not c.own and {*_FAR} & {*c.free} & {*elsewhere}]
        there = [{n: v for n, v in elsewhere.items() if n in c.free or n not in _FAR} for c in first]
        begun = [replace(c, starts=({}, start)) for c, start in zip(first, there, strict=True)]
        listed = [*begun[::-1], *(c for c in listed if c not in first)]  # a bias first: steering follows by it
    left = (replace(c, free=tuple(n for n in c.free if n not in (own or ()))) for c in listed)
    return tuple(c for c in left if c.free)


def _sessions(data: Dataset) -> bool:
    """Whether there are several recordings, long enough to be sessions with sensors zeroed in between."""
    count = len(set(recordings(data)))
    return count > 1 and data.duration > _SESSION * count


def friction_used(data: Dataset, p: SaturatingBicycleParams | None = None) -> float:
    """Largest lateral acceleration of a log over that of gravity, and of the downforce of a car ``p``; no outliers."""
    load = 1.0 if p is None else p.load_ratio(data["v_x"])
    return float(np.quantile(np.abs(data["v_x"] * data["r"]) / load, 0.999)) / GRAVITY


def fastest_steering(data: Dataset, share: float) -> float:
    """Rate of the logged steering below which it stays for a share of the time. [rad/s]"""
    rates = [np.abs(np.diff(part["delta"])) / part.dt for part in data.experiments]
    return max(float(np.quantile(np.concatenate(rates), share)), 1e-3)


def _brakes(data: Dataset) -> bool:
    """Whether the car gains or loses speed so much in a twentieth of the time that loads shift."""
    n = max(1, round(_OVER / data.dt))
    rates = [np.abs(part["v_x"][n:] - part["v_x"][:-n]) / (n * part.dt) for part in data.experiments]
    return float(np.quantile(np.concatenate(rates), 0.95)) > _BRAKES * GRAVITY


def _steered(model: Any) -> Any:
    """With a lag that the integrator follows; none at all would be shorter than any that it can."""
    car = model.model
    return replace(model, model=Steered(car, steering_lag=2.0 * car.dt / car.substeps))


def _loaded(model: Any) -> Any:
    """With axles whose loads shift, as of a centre of gravity of usual height, driven by all wheels."""
    return replace(model, model=LoadTransfer(model.model, height=0.2 * model.value("wheelbase"), drive_rear=0.5))


def _relaxing(model: Any) -> Any:
    """With tires that relax, whatever is around the car."""
    if hasattr(model, "model"):
        return replace(model, model=_relaxing(model.model))
    return RelaxingBicycle(params=model.params, dt=model.dt, outputs=model.outputs, small_angles=model.small_angles)
