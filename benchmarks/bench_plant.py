"""Steps of the dual-track plant per second: compiled, on CasADi's virtual machine, beside an independent car.

Ours: 30 states, Magic Formula 6.1 with combined slip on four wheels, Runge-Kutta of fourth order at one millisecond.
The peer is the multi-body car of commonroad-vehicle-models (29 states, no relaxation) in Python with the same scheme
and step. Same speed, gentle driving, one thread, in turn; process time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from slipangle.codegen.compiler import sentence
from slipangle.models.fast import roll_out
from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

ROUNDS, STEPS, CARS = 15, 20_000, 256
V_X = 20.0


def bench(progress: Progress) -> Reproduction:
    """Steps per second of each."""
    car = DualTrack(params=BMW_320I, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001)
    t = np.arange(STEPS) * car.dt
    u = np.column_stack([0.03 * np.sin(3.0 * t), np.full(STEPS, 0.15), np.zeros(STEPS)])
    x = car.straight(V_X)
    step = car.functions[0]
    many = u[:200, None] * np.linspace(0.5, 1.5, CARS)[:, None]
    starts = np.tile(x, (CARS, 1))
    runs: dict[str, tuple[int, Callable[[], np.ndarray]]] = {
        "virtual machine": (4000, lambda: roll_out(step, x, u[:4000]))
    }
    kernel = car.kernel
    if kernel is not None:
        runs["compiled, one car"] = (STEPS, lambda: kernel.run(x, u))
        runs[f"compiled, {CARS} cars"] = (200 * CARS, lambda: kernel.run_many(starts, many, last_only=True))
    peer = _peer()
    if peer is not None:
        runs["commonroad multi-body"] = (60, peer)
    spent: dict[str, list[float]] = {name: [] for name in runs}
    results = {}
    for _, run in runs.values():
        run()
    for i in range(ROUNDS):
        for name, (n, run) in runs.items():
            progress((i + 0.5) / ROUNDS, f"{name}, round {i + 1}")
            began = time.process_time()
            results[name] = run()
            spent[name].append((time.process_time() - began) / n)
    bounds = {"compiled, one car": 300e3, f"compiled, {CARS} cars": 1.5e6}
    records = []
    for name, seconds in spent.items():
        rate = 1 / float(np.median(seconds))
        bound = bounds.get(name)
        records.append(
            Record(
                row=name,
                quantity="plant steps per second, median",
                thesis=None,
                here=rate,
                bound="" if bound is None else f">= {bound:,.0f}".replace(",", " "),
                holds=None if bound is None else rate >= bound,
                note=f"p99 {1 / float(np.percentile(seconds, 99)):.3g}; {rate * car.dt:.3g} times real time",
            )
        )
    for missing, note in (("compiled, one car", sentence()), ("commonroad multi-body", "peer is not installed")):
        if missing not in runs:
            records.append(
                Record(row=missing, quantity="plant steps per second", thesis=None, here="not run", note=note)
            )
    if kernel is not None:
        gap = float(np.abs(results["compiled, one car"][:4001] - results["virtual machine"]).max())
        records.append(
            Record(
                row="compiled and virtual machine",
                quantity="largest difference of any state after 4 s",
                thesis=None,
                here=gap,
                bound="<= 1e-8",
                holds=gap <= 1e-8,
            )
        )
    return Reproduction(
        title="Dual-track plant, Runge-Kutta 4 at 1 ms",
        records=tuple(records),
        protocol=f"{STEPS} steps of one car, 200 of {CARS} cars; median of {ROUNDS} rounds in turn, process time, one "
        "thread.",
    )


def _peer() -> Callable[[], np.ndarray] | None:
    """Sixty steps of the other car."""
    if find_spec("vehiclemodels") is None:
        return None
    from vehiclemodels.init_mb import init_mb
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
    from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

    p = parameters_vehicle2()
    start = np.array(init_mb([0.0, 0.0, 0.0, V_X, 0.0, 0.0, 0.0], p))
    h = 0.001

    def rate(x: np.ndarray) -> np.ndarray:
        return np.array(vehicle_dynamics_mb(x.tolist(), [0.1, 0.3], p))

    def run() -> np.ndarray:
        x = start
        for _ in range(60):
            a = rate(x)
            b = rate(x + h / 2 * a)
            c = rate(x + h / 2 * b)
            d = rate(x + h * c)
            x = x + h / 6 * (a + 2 * b + 2 * c + d)
        return x

    return run
