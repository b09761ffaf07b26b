"""What the colour of an ARX model's residual says of its coefficients."""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.models.black_box.arx import ARXModel
from slipangle.numerics.covariance import autoregression

_SEEN = 1 << 14  # samples that are looked at, from the start
_SHARE = 0.01  # of the residual's variance that its own past tells, from which it is called coloured
_NOISE = 1e-6  # residual in parts of the output, below which it is rounding


def colour_said(model: ARXModel, data: Dataset) -> tuple[str, ...]:
    """A sentence for each output whose one-step-ahead residual its own past predicts.

    Least squares is unbiased only if past outputs are independent of the residual, so only if it is white [1]_. The
    order of the residual's autoregression is that of least BIC, which a white one leaves at 0.

    References
    ----------
    .. [1] L. Ljung, System Identification, 2nd ed., 1999, sec. 7.3, 7.6.
    """
    seen = data.rows(0, min(_SEEN, data.n_samples)).experiments
    errors = [e for e in (_residual(model, part) for part in seen) if len(e) > 1]
    if not errors:
        return ()
    said = []
    for i, output in enumerate(model.outputs):
        pieces = [e[:, [i]] for e in errors]
        total = float(np.mean(np.concatenate(pieces) ** 2))
        if not np.isfinite(total) or total <= _NOISE**2 * float(np.var(data[output])):
            continue
        coefficients, driving = autoregression(pieces)
        told = 1.0 - float(driving[0, 0]) / total
        if len(coefficients) and told > _SHARE:
            lag = sum(float(p[1:, 0] @ p[:-1, 0]) for p in pieces) / sum(float(p[:, 0] @ p[:, 0]) for p in pieces)
            said.append(
                f"the noise of {output} is coloured ({100 * told:.0f} % of the residual follow from its past, "
                f"correlation {lag:+.2f} at one sample): it biases the coefficients of an ARX model, which their "
                "intervals do not count; expected a white residual: use OutputError, BoxJenkins or StateSpace, or more "
                "lags"
            )
    return tuple(said)


def _residual(model: ARXModel, part: Dataset) -> np.ndarray:
    """One-step-ahead errors of an experiment, shape (n, n_outputs); none where it is shorter than the lags."""
    y, u, n = part.columns(model.outputs), part.columns(model.inputs), part.n_samples
    first = max(len(model.A), model.nk + len(model.B) - 1)
    if n <= first:
        return np.zeros((0, len(model.outputs)))
    e = y[first:] - model.c
    for lag, a in enumerate(model.A, 1):
        e += y[first - lag : n - lag] @ a.T
    for lag, b in enumerate(model.B, model.nk):
        e -= u[first - lag : n - lag] @ b.T
    return e
