"""ARX(10, 10) on ten million samples: least squares and free run, ours beside peers.

One input, one output, a stable system of order 10 with white noise on the equation; one thread; processor time, as
others may share the machine. Peers that are slow or keep all regressors take fewer samples. The memory is what Python
and NumPy allocate beyond the data. sysidentpy, sippy_unipi and pysindy are used where they are installed.
"""

from __future__ import annotations

import time
import tracemalloc
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import lfilter

from slipangle.codegen import compiler as compiled
from slipangle.data.dataset import Dataset
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.multi_arx import MultiARX
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.wrappers.multi_arx import MultiARXModel
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._peers import absent, choice_over_fit, in_turn, installed, median_record

SAMPLES, FEWER, ROUNDS = 10_000_000, 100_000, 7
SECONDS, MEGABYTES, RATE = 1.0, 200.0, 1e8
CHOICES, FITS = (1_000, 10_000, 50_000), 5.0  # samples of which orders are chosen, and what that may cost
PEERS = ("sysidentpy", "sippy_unipi", "pysindy")


def bench(progress: Progress) -> Reproduction:
    """Seconds and megabytes of a fit, samples per second of a free run."""
    progress(0.0, "making the data")
    data = record(SAMPLES)
    records = fits(data, lambda share, what: progress(0.6 * share, what))
    records += free_runs(data, lambda share, what: progress(0.6 + 0.4 * share, what))
    records += [order_choice(data.head(n)) for n in CHOICES]
    records += [order_choice_by_speed(at_speeds(n)) for n in CHOICES]
    return Reproduction(
        title="ARX(10, 10), ten million samples",
        records=(*records, *absent(PEERS, "ARX")),
        protocol=(
            f"{SAMPLES} samples, slow peers {FEWER} and their seconds scaled up; one thread, processor time, medians "
            f"over {ROUNDS} rounds in turn (peers 3). Ours: {compiled.sentence()}."
        ),
    )


def true_model() -> ARXModel:
    """A stable system with ten lags of each."""
    poles = np.array([0.9, 0.8, 0.6 + 0.3j, 0.6 - 0.3j, 0.5, -0.4, 0.3, -0.2, 0.1, 0.05])
    B = 0.1 * np.random.default_rng(0).standard_normal(10)
    return ARXModel(A=np.real(np.poly(poles))[1:], B=B, dt=1.0, inputs=("u",), outputs=("y",))


def record(n: int) -> Dataset:
    """Its noisy output under a random input."""
    model, rng = true_model(), np.random.default_rng(1)
    u, e = rng.standard_normal(n), 0.1 * rng.standard_normal(n)
    denominator = np.concatenate([[1.0], model.A[:, 0, 0]])
    y = lfilter(np.concatenate([[0.0], model.B[:, 0, 0]]), denominator, u) + lfilter([1.0], denominator, e)
    return Dataset.from_arrays({"u": u}, {"y": y}, 1.0)


# ---- fit -----------------------------------------------------------------------------------------------------------


def fits(data: Dataset, progress: Progress) -> list[Record]:
    """Every least-squares fit of the same 20 coefficients."""
    fewer = data.head(FEWER)
    runs: dict[str, tuple[Callable[[], Any], int]] = {
        "slipangle": (lambda: coefficients(ARX(na=10, nb=10).fit(data)), SAMPLES),
        f"slipangle, {FEWER} samples": (lambda: coefficients(ARX(na=10, nb=10).fit(fewer)), FEWER),
        "NumPy lstsq on all regressors": (lambda: plain(fewer), FEWER),
    }
    makers = {"sysidentpy": sysidentpy_fit, "sippy_unipi": sippy_fit, "pysindy": pysindy_fit}
    runs |= {name: (lambda make=make: make(fewer), FEWER) for name, make in makers.items() if installed(name)}
    rates, found = in_turn(runs, progress, rounds=ROUNDS, clock=time.process_time)
    exact = coefficients(ARX(na=10, nb=10).fit(fewer))
    records = []
    for name, rate in rates.items():
        if name != "slipangle" and name.startswith("slipangle"):
            continue
        known = exact if name != "slipangle" else coefficients(true_model())
        what = "from the same fit by slipangle" if name != "slipangle" else "from the true ones"
        note = f"coefficients differ by {np.abs(found[name] - known).max():.1g} {what}"
        seconds = [SAMPLES / r for r in rate]
        quantity = "s" if runs[name][1] == SAMPLES else f"s, {FEWER} samples scaled up"
        bound = f"<= {SECONDS:g}" if name == "slipangle" else ""
        records.append(median_record(f"fit, {name}", quantity, seconds, bound=bound, most=True, note=note))
    tracemalloc.start()
    ARX(na=10, nb=10).fit(data)
    peak = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    bound = f"<= {MEGABYTES:g}"
    records.append(median_record("fit, slipangle", "MB beyond the data", [peak], bound=bound, most=True))
    return records


def order_choice(data: Dataset) -> Record:
    """Fits of the chosen orders that a fit costs which chooses them."""
    ratios = choice_over_fit(lambda: ARX().fit(data), lambda m: ARX(na=m.na, nb=m.nb, nk=m.nk).fit(data), rounds=ROUNDS)
    name = f"order choice over one fit, {data.n_samples} samples"
    return median_record(name, "fits", ratios, bound=f"<= {FITS:g}", most=True)


def at_speeds(n: int) -> Dataset:
    """Output of a model whose coefficients go with the speed, which wanders from 4 to 16 m/s, and noise."""
    rng = np.random.default_rng(0)
    u, v_x, y = rng.standard_normal(n), 10 + 6 * np.sin(np.arange(n) / 57.0), np.zeros((n, 2))
    for k in range(2, n):
        gain = v_x[k - 1] / 10
        y[k, 0] = 1.2 * y[k - 1, 0] - 0.5 * y[k - 2, 0] + 0.1 * y[k - 1, 1] + gain * u[k - 1]
        y[k, 1] = 0.7 * y[k - 1, 1] + 0.3 * gain * u[k - 2]
    return Dataset.from_arrays({"u": u, "v_x": v_x}, {"y": y[:, 0] + 0.1 * rng.standard_normal(n)}, 0.1)


def order_choice_by_speed(data: Dataset) -> Record:
    """The same of ARX models that are blended by speed, the speeds chosen too."""

    def again(model: MultiARXModel) -> MultiARXModel:
        one = model.models[0]
        return MultiARX(na=one.na, nb=one.nb, nk=one.nk, speeds=model.speeds).fit(data)

    ratios = choice_over_fit(lambda: MultiARX().fit(data), again, rounds=ROUNDS)
    name = f"order choice over one fit, by speed, {data.n_samples} samples"
    return median_record(name, "fits", ratios, bound=f"<= {FITS:g}", most=True)


def coefficients(model: ARXModel) -> np.ndarray:
    """Ten of A, ten of B."""
    return np.concatenate([model.A[:, 0, 0], model.B[:, 0, 0]])


def regressors(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """All of them as one matrix, and the target."""
    u, y = data["u"], data["y"]
    n = len(y)
    columns = [-y[10 - i : n - i] for i in range(1, 11)] + [u[10 - j : n - j] for j in range(1, 11)]
    return np.column_stack(columns), y[10:]


def plain(data: Dataset) -> np.ndarray:
    """The textbook's way."""
    return np.linalg.lstsq(*regressors(data), rcond=None)[0]


def sysidentpy_model(data: Dataset) -> Any:
    """ARX as sysidentpy's linear NARMAX with all terms."""
    from sysidentpy.basis_function import Polynomial  # type: ignore[import-not-found]
    from sysidentpy.model_structure_selection import FROLS  # type: ignore[import-not-found]
    from sysidentpy.parameter_estimation import LeastSquares  # type: ignore[import-not-found]

    model = FROLS(
        order_selection=False,
        n_terms=20,
        ylag=10,
        xlag=10,
        basis_function=Polynomial(degree=1),
        estimator=LeastSquares(),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model.fit(X=data["u"][:, None], y=data["y"][:, None])
    return model


def sysidentpy_fit(data: Dataset) -> np.ndarray:
    """Its coefficients in our order."""
    model = sysidentpy_model(data)
    found = np.zeros(20)
    for code, value in zip(model.final_model[:, 0], np.ravel(model.theta), strict=True):
        kind, lag = divmod(int(code), 1000)  # 1001: y(k-1), 2001: u(k-1), 0: constant
        if kind:
            found[(kind - 1) * 10 + lag - 1] = value if kind == 2 else -value
    return found


def sippy_model(data: Dataset) -> Any:
    """ARX of SIPPY."""
    from sippy_unipi import system_identification  # type: ignore[import-not-found]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return system_identification(data["y"], data["u"], "ARX", ARX_orders=[10, 10, 0])  # its delays start at 0


def sippy_fit(data: Dataset) -> np.ndarray:
    """Its coefficients in our order."""
    model = sippy_model(data)
    numerator, denominator = np.ravel(model.G.num[0][0]), np.ravel(model.G.den[0][0])
    return np.concatenate([denominator[1:11], numerator[-10:]])


def pysindy_fit(data: Dataset) -> np.ndarray:
    """The sparse regression of pysindy, with nothing to be thinned out, on regressors made beforehand."""
    from pysindy.optimizers import STLSQ  # type: ignore[import-not-found]

    phi, target = regressors(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.ravel(STLSQ(threshold=0.0, alpha=0.0).fit(phi, target[:, None]).coef_)


# ---- free run ------------------------------------------------------------------------------------------------------


def free_runs(data: Dataset, progress: Progress) -> list[Record]:
    """The same coefficients run freely."""
    model = true_model()
    numerator = np.concatenate([[0.0], model.B[:, 0, 0]])
    denominator = np.concatenate([[1.0], model.A[:, 0, 0]])
    fewer, u = data.head(20_000), np.ascontiguousarray(data["u"])
    runs: dict[str, tuple[Callable[[], Any], int]] = {
        "slipangle": (lambda: model.simulate(data).y[:, 0], SAMPLES),
        "SciPy lfilter, from rest, without time and checks": (lambda: lfilter(numerator, denominator, u), SAMPLES),
    }
    if installed("sysidentpy"):
        fitted = sysidentpy_model(data.head(2_000))
        drive, start = fewer["u"][:, None], fewer["y"][:10, None]
        runs["sysidentpy"] = (lambda: fitted.predict(X=drive, y=start)[:, 0], fewer.n_samples)
    if installed("sippy_unipi"):
        known = sippy_model(data.head(2_000))
        runs["sippy_unipi, from rest"] = (lambda: sippy_free_run(known, fewer), fewer.n_samples)
    model.simulate(data)  # compile
    rates, _ = in_turn(runs, progress, rounds=ROUNDS, clock=time.process_time)
    records = []
    for name, rate in rates.items():
        bound = f">= {RATE:g}" if name == "slipangle" else ""
        records.append(median_record(f"free run, {name}", "samples/s", rate, bound=bound))
    return records


def sippy_free_run(model: Any, data: Dataset) -> np.ndarray:
    """The transfer function of SIPPY's model through python-control."""
    import control  # type: ignore[import-not-found]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.ravel(control.forced_response(model.G, U=data["u"]).outputs)
