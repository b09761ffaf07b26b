"""What the colour of an ARX model's residual says of its coefficients."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from slipangle.data.dataset import Dataset, join
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
    parts = [part for part in seen if part.n_samples > model.memory]
    if not parts:
        return ()
    run = model._predict(join(*parts))
    said = []
    for i, output in enumerate(model.outputs):
        e = np.where(run.predicted, run.error[:, i], np.nan)
        pieces = [e[a:b][run.predicted[a:b]][:, None] for a, b in pairwise((*run.starts, len(e)))]
        pieces = [p for p in pieces if len(p) > 1]
        total = float(np.mean(np.concatenate(pieces) ** 2)) if pieces else 0.0
        if not np.isfinite(total) or total <= _NOISE**2 * float(np.var(run.measured[:, i])):
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
