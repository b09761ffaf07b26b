"""One update of recursive estimators: ours beside peers.

RLS of ARX models with 4, 8 and 20 coefficients, called once per sample from Python with two numbers, as in a control
loop; the extended Kalman filter of a bicycle with two states, two free parameters and two outputs. One thread; medians
over all updates of each round. sysidentpy's recursive least squares runs over a whole record at once.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from slipangle.codegen import compiler as compiled
from slipangle.estimate.ekf import EKF
from slipangle.identify.linear.recursive import RLS
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._peers import absent, installed, median_record

UPDATES, ROUNDS, MICROSECONDS = 20_000, 7, 2.0
TYPICAL = 4  # lags of each: eight coefficients


def bench(progress: Progress) -> Reproduction:
    """Microseconds per update."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(UPDATES)
    y = np.zeros(UPDATES)
    for k in range(2, UPDATES):
        y[k] = 1.5 * y[k - 1] - 0.7 * y[k - 2] + u[k - 1] + 0.5 * u[k - 2] + 0.05 * rng.standard_normal()
    makers: dict[str, Callable[[], Callable[[float, float], Any]]] = {}
    for lags in (2, TYPICAL, 10):
        makers[f"slipangle RLS, {2 * lags} coefficients"] = lambda lags=lags: ours(lags)
    makers[f"NumPy RLS, {2 * TYPICAL} coefficients"] = lambda: numpy_rls(TYPICAL)
    makers["slipangle EKF, bicycle, C_f and C_r"] = kalman
    times: dict[str, list[float]] = {name: [] for name in makers}
    for i in range(ROUNDS):
        for j, (name, make) in enumerate(makers.items()):
            progress((i + j / len(makers)) / ROUNDS, f"{name}, round {i + 1}")
            times[name].append(median_of(make(), y, u))
    bound = f"<= {MICROSECONDS:g}"
    records = [
        median_record(name, "us per update", values, bound=bound if "slipangle RLS" in name else "", most=True)
        for name, values in times.items()
    ]
    if installed("sysidentpy"):
        seconds = sysidentpy(y[:2_000], u[:2_000])
        note = "over a record of 2000 samples, one run"
        row = f"sysidentpy, {2 * TYPICAL} coefficients"
        records.append(median_record(row, "us per update", [1e6 * seconds / 2_000], most=True, note=note))
    return Reproduction(
        title="Recursive estimators, one update",
        records=(*records, *absent(("sysidentpy",), "RLS")),
        protocol=f"{UPDATES} updates a round, {ROUNDS} rounds in turn, medians. Ours: {compiled.sentence()}.",
    )


def median_of(update: Callable[[float, float], Any], y: np.ndarray, u: np.ndarray) -> float:
    """Median time of an update, the clock's own time included. [us]"""
    pairs, clock = list(zip(y.tolist(), u.tolist(), strict=True)), time.perf_counter_ns
    taken = np.empty(len(pairs))
    for k, (now, drive) in enumerate(pairs):
        began = clock()
        update(now, drive)
        taken[k] = clock() - began
    return float(np.median(taken)) / 1e3


def ours(lags: int) -> Callable[[float, float], Any]:
    """Forgetting along the regressors."""
    return RLS(na=lags, nb=lags, forgetting=0.99).start(inputs="u", outputs="y", dt=0.01).update


def numpy_rls(lags: int) -> Callable[[float, float], Any]:
    """The textbook's update with exponential forgetting, in NumPy."""
    P, theta, phi = 1e6 * np.eye(2 * lags), np.zeros(2 * lags), np.zeros(2 * lags)

    def update(y: float, u: float) -> None:
        gain = P @ phi
        gain /= 0.99 + phi @ gain
        theta[:] += gain * (y - phi @ theta)
        P[:] = (P - np.outer(gain, phi @ P)) / 0.99
        phi[1:lags], phi[lags + 1 :] = phi[: lags - 1].copy(), phi[lags:-1].copy()
        phi[0], phi[lags] = y, u

    return update


def kalman() -> Callable[[float, float], Any]:
    """Both outputs made of one number, steering of the other; what matters is the time."""
    model = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r", "a_y"))
    settings = EKF(start=model, free=("C_f", "C_r"), noise_std={"r": 0.01, "a_y": 0.2}, process_std={"v_y": 0.1})
    filter_, outputs, inputs = settings.start_at(), np.zeros(2), np.array([0.0, 20.0])

    def update(y: float, u: float) -> None:
        outputs[0], outputs[1], inputs[0] = 1e-3 * y, 0.1 * y, 1e-3 * u
        filter_.update(outputs, inputs)

    return update


def sysidentpy(y: np.ndarray, u: np.ndarray) -> float:
    """Its recursive least squares on all regressors of a record. [s]"""
    from sysidentpy.parameter_estimation import RecursiveLeastSquares  # type: ignore[import-not-found]

    n = len(y)
    columns = [s[TYPICAL - i : n - i] for s in (y, u) for i in range(1, TYPICAL + 1)]
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        RecursiveLeastSquares(lam=0.99).optimize(np.column_stack(columns), y[TYPICAL:, None])
    return time.perf_counter() - began
