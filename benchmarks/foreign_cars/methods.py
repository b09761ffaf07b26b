"""The methods: from a log and what is known of the car to intervals, a free run and sentences."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from benchmarks.foreign_cars import scipy_fit
from benchmarks.foreign_cars.scipy_fit import Known

from slipangle.data.dataset import Dataset
from slipangle.data.quality.inspect import inspect
from slipangle.identify.car.identify_car import identify_car
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.ode import OdeModel
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams
from slipangle.models.wrappers.delayed import Delayed

SHOWN = ("C_f", "C_r", "inertia_z")  # what is judged beside the free run
DT = 0.05  # s, to which the README resamples


@dataclass(frozen=True, kw_only=True)
class Found:
    """What a method makes of a log: intervals of 95 % by parameter, and a free run of its outputs.

    ``inseparable`` are parameters of which it says that the log cannot tell them; ``sentences`` warn of what seems
    wrong with the log or with what is known of the car.
    """

    intervals: dict[str, tuple[float, float]]
    simulate: Callable[[Dataset], np.ndarray]
    inseparable: tuple[str, ...] = ()
    sentences: tuple[str, ...] = ()


Method = Callable[[Dataset, Known, tuple[str, ...]], Found]


def by_hand(data: Dataset, known: Known, outputs: tuple[str, ...]) -> Found:
    """The competitor."""
    fit = scipy_fit.fit(data, known, outputs)
    intervals = {n: (v - 1.96 * fit.std[n], v + 1.96 * fit.std[n]) for n, v in fit.values.items()}
    return Found(intervals=intervals, simulate=fit.simulate)


def delayed_bicycle(data: Dataset, known: Known, outputs: tuple[str, ...]) -> Found:
    """The linear bicycle with a free delay of the steering."""
    late = Delayed(_start(known, outputs, data), delays={"delta": 0.05}, longest=0.3)
    return _grey_box(late, (*SHOWN, "delay_delta"), data)


def whole_car(data: Dataset, known: Known, outputs: tuple[str, ...]) -> Found:
    """`identify_car` with nothing but what its user knows."""
    found = identify_car(data.hold_mean(), mass=known.mass, wheelbase=known.wheelbase, l_f=known.l_f)
    info = found.model.fit_info
    return Found(
        intervals=dict(zip(info.names, map(tuple, info.interval().tolist()), strict=True)),
        simulate=lambda log: found.model.simulate(log.hold_mean()).y,
        inseparable=tuple(name for name, fine in found.separated.items() if not fine),
        sentences=found.doubts,
    )


METHODS: dict[str, Method] = {"scipy": by_hand, "delayed bicycle": delayed_bicycle, "identify_car": whole_car}
OURS = "identify_car"  # the one that is held to the bounds


def _start(known: Known, outputs: tuple[str, ...], data: Dataset) -> Bicycle:
    l_r = known.wheelbase - known.l_f
    load = 15 * known.mass * GRAVITY / known.wheelbase
    guess = {"C_f": load * l_r, "C_r": load * known.l_f, "inertia_z": known.mass * known.l_f * l_r}
    params = BicycleParams(mass=known.mass, wheelbase=known.wheelbase, l_f=known.l_f, **guess)
    return Bicycle(params=params, dt=max(DT, data.dt), outputs=outputs)


def _grey_box(start: Bicycle | Delayed, free: tuple[str, ...], data: Dataset) -> Found:
    if data.dt > 1.0:  # thousands of steps within a sample: nobody would wait for the fit
        return Found(intervals={}, simulate=lambda log: log.y, sentences=inspect(data).sentences[1:])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = GreyBox(start=start, free=free).fit(data.resample(start.dt))
    info = model.fit_info
    assert info is not None  # noqa: S101
    said = (*info.warnings, *inspect(data).sentences[1:])

    def simulate(log: Dataset) -> np.ndarray:
        return _at(model, log.dt).simulate(log.hold_mean()).y

    intervals = dict(zip(info.names, map(tuple, info.interval().tolist()), strict=True))
    return Found(intervals=intervals, simulate=simulate, sentences=said)


def _at(model: OdeModel | Delayed, dt: float) -> OdeModel | Delayed:
    """The model at another sample time."""
    if isinstance(model, Delayed):
        return replace(model, model=_at(model.model, dt))
    return replace(model, dt=dt, substeps=0)
