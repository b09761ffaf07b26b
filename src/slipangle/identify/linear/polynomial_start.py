"""Where the search for polynomial models starts: a long ARX model, taken apart by least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from slipangle.data.dataset import Dataset
from slipangle.errors import ExcitationError, TooShortError
from slipangle.identify.linear.arx import ARX
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.polynomial import one

Signals = list[np.ndarray]  # one array per experiment


def first_guess(
    settings: Any,
    nb: tuple[int, ...],
    nf: tuple[int, ...],
    nk: tuple[int, ...],
    data: Dataset,
    u0: np.ndarray,
    y0: float,
) -> np.ndarray:
    """Coefficients of a `Polynomial` of these settings in the order A, B, F, C, D.

    The long ARX model's response to each input is what B / F must give: output-error least squares with the
    prefilters of Steiglitz and McBride. Its residual stands for e in what C and D must give (Hannan and Rissanen).

    Source: L. Ljung, System Identification, 2nd ed., 1999, sec. 10.4.
    """
    parts = data.experiments
    u: list[Signals] = [[part.u[:, i] - u0[i] for part in parts] for i in range(len(nb))]
    y: Signals = [part.y[:, 0] - y0 for part in parts]
    long = long_arx(data, u0, y0, settings, max(*nb, *nf, settings.na, settings.nc, settings.nd), max(nk))
    innovation = [_residual(long, [s[e] for s in u], y[e]) for e in range(len(y))]
    if settings.nd == 0 and not any(nf):  # ARMAX: one linear regression
        columns = [(y, range(1, settings.na + 1), -1.0)]
        columns += [(u[i], range(nk[i], nk[i] + nb[i]), 1.0) for i in range(len(nb))]
        columns += [(innovation, range(1, settings.nc + 1), 1.0)]
        theta = _regress(y, columns)
        a, b = theta[: settings.na], theta[settings.na : len(theta) - settings.nc]
        if settings.max_radius is not None:
            a = _reflected(a, 0.98 * settings.max_radius)
        return np.concatenate([a, b, _reflected(theta[len(theta) - settings.nc :])])
    numerators, denominators, rest = [], [], y
    for i in range(len(nb)):
        response = [_filter(np.r_[np.zeros(long.nk), long.B[:, 0, i]], one(long.A[:, 0, 0]), s) for s in u[i]]
        b, f = _steiglitz_mcbride(u[i], response, nb[i], nf[i], nk[i])
        numerators.append(b)
        denominators.append(f)
        rest = [r - _filter(np.r_[np.zeros(nk[i]), b], one(f), s) for r, s in zip(rest, u[i], strict=True)]
    limit = settings.max_radius if settings.nc + settings.nd or settings.max_radius is not None else 1.0
    if limit is not None:
        denominators = [_reflected(f, 0.98 * limit) for f in denominators]
    columns = [(rest, range(1, settings.nd + 1), -1.0), (innovation, range(1, settings.nc + 1), 1.0)]
    theta = _regress(rest, columns) if settings.nd + settings.nc else np.zeros(0)
    d, c = _reflected(theta[: settings.nd]), _reflected(theta[settings.nd :])
    return np.concatenate([np.zeros(settings.na), *numerators, *denominators, c, d])


def long_arx(data: Dataset, u0: np.ndarray, y0: float, settings: Any, order: int, nk: int) -> ARXModel:
    """ARX with as many lags as the data bear."""
    centred = data
    for name, level in zip((*data.inputs, *data.outputs), (*u0, y0), strict=True):
        if level:
            centred = centred.with_channel(name, data[name] - level, data.unit(name))
    lags = max(order + 1, min(30, 2 * order + nk + 10, data.n_longest // (4 * (1 + len(data.inputs)))))
    while True:
        try:
            return ARX(na=lags, nb=lags)._fit(centred)
        except (ExcitationError, TooShortError):  # clean data bear no more lags than the system has
            if lags <= 1:
                raise
            lags -= 1 if lags <= order + 2 else (lags - order) // 2


def _residual(model: ARXModel, u: Signals, y: np.ndarray) -> np.ndarray:
    """One-step-ahead error from rest."""
    e = _filter(one(model.A[:, 0, 0]), [1.0], y)
    for i, s in enumerate(u):
        e = e - _filter(np.r_[np.zeros(model.nk), model.B[:, 0, i]], [1.0], s)
    return e


def _steiglitz_mcbride(u: Signals, w: Signals, nb: int, nf: int, nk: int) -> tuple[np.ndarray, np.ndarray]:
    """B and F of ``w = B / F u``, least squares on prefiltered signals, a few times; the best of them."""
    f, tried = np.zeros(nf), []
    for _ in range(8 if nf else 1):
        past_w, past_u = ([_filter([1.0], one(f), s) for s in signals] for signals in (w, u))
        theta = _regress(past_w, [(past_w, range(1, nf + 1), -1.0), (past_u, range(nk, nk + nb), 1.0)])
        f = _reflected(theta[:nf])
        responses = [[_filter(np.eye(1, nk + j + 1, nk + j)[0], one(f), s) for s in u] for j in range(nb)]
        b = _regress(w, [(r, range(1), 1.0) for r in responses])
        rest = [t - sum(c * r[e] for c, r in zip(b, responses, strict=True)) for e, t in enumerate(w)]
        tried.append((sum(float(r @ r) for r in rest), b, f))
    _, b, f = min(tried, key=lambda found: found[0])
    return b, f


def _filter(b: list[float] | np.ndarray, a: list[float] | np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.asarray(scipy.signal.lfilter(b, a, x))


def _regress(target: Signals, columns: list[tuple[Signals, range, float]]) -> np.ndarray:
    """Least squares of the target on lags of signals, past each experiment's first samples."""
    reach = max((max(lags, default=0) for _, lags, _ in columns), default=0)
    rows, right = [], []
    for e, y in enumerate(target):
        n = len(y)
        if n <= reach:
            continue
        picked = [sign * signals[e][reach - lag : n - lag] for signals, lags, sign in columns for lag in lags]
        rows.append(np.column_stack(picked) if picked else np.zeros((n - reach, 0)))
        right.append(y[reach:])
    phi = np.vstack(rows)
    scale = np.maximum(np.linalg.norm(phi, axis=0), 1e-300)
    return np.linalg.lstsq(phi / scale, np.concatenate(right), rcond=1e-10)[0] / scale


def _reflected(coefficients: np.ndarray, radius: float = 0.995) -> np.ndarray:
    """The polynomial with the roots beyond a radius moved onto it."""
    if len(coefficients) == 0:
        return coefficients
    roots = np.roots(one(coefficients)).astype(complex)
    outside = np.abs(roots) > radius
    roots[outside] *= radius / np.abs(roots[outside])
    return np.real(np.poly(roots))[1:]
