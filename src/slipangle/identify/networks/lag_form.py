"""A linear state space as a difference equation of past outputs and inputs, in which a network of lags can start."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import IdentifiabilityWarning, ModelWarning, SlipangleError
from slipangle.identify.linear.delays import delayed
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.linear.waiting import settled
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.networks import Scaling
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.plausible import growth

_MORE = (10, 5, 2, 0)  # lags beyond the fewest: the more, the less a free run feels the noise of those it starts from
ALIKE = 1.02  # squared error over the least of these, up to which the most lags are taken
_MOST = 30  # lags of an input


def state_space(data: Dataset) -> tuple[StateSpaceModel, tuple[int, ...]] | None:
    """The linear state space of the data with levels, stable, and by how much each input is late; None without one.

    It has no direct path.
    """
    with warnings.catch_warnings():
        for kind in (ModelWarning, IdentifiabilityWarning):  # of a model that is only to begin with
            warnings.simplefilter("ignore", kind)
        try:
            settings, waits = settled(StateSpace(offsets="output", max_radius=1.0), data)
            model = replace(settings, direct=False).fit(delayed(data, waits))
        except SlipangleError:
            return None
    return None if growth(model.poles, data.n_longest) else (model, tuple(waits.values()))


def lag_forms(model: StateSpaceModel, waits: tuple[int, ...]) -> list[ARXModel]:
    """The same model by many lags, and by fewer; none where inputs are late by too unlike times."""
    least = -(-model.order // model.n_outputs)
    counts = [least + more for more in _MORE if least + more + max(waits) - min(waits) <= _MOST]
    return [lag_form(model, count, waits) for count in counts]


def lag_form(model: StateSpaceModel, lags: int, waits: tuple[int, ...]) -> ARXModel:
    """The difference equation that the state space's free run keeps to, of all with so many lags the flattest one.

    Of the many that there are, that with the least squares of its output coefficients passes on the least noise from
    the outputs that a free run starts from, and has no unstable roots beyond the model's own.

    Source: R. Kumaresan, On the zeros of the linear prediction-error filter for deterministic signals, IEEE Trans.
    ASSP 31(1), 1983, for one output.
    """
    ny, nu, C = model.n_outputs, model.n_inputs, np.array(model.C)
    seen, response = [C], [np.array(C @ model.B)]  # by the state so many samples before; to the inputs, from lag 1 on
    for _ in range(lags):
        response.append(seen[-1] @ model.A @ model.B)
        seen.append(seen[-1] @ model.A)
    flat = seen[lags] @ np.linalg.pinv(np.vstack(seen[:lags]), rcond=1e-10)
    W = flat.reshape(ny, lags, ny).transpose(1, 0, 2)[::-1]  # newest first
    first = min(waits)
    B = np.zeros((lags + max(waits) - first, ny, nu))
    for j in range(lags):
        own = response[j] - sum((W[i] @ response[j - 1 - i] for i in range(j)), np.zeros((ny, nu)))
        for i, wait in enumerate(waits):
            B[j + wait - first, :, i] = own[:, i]
    c = model.y_offset - W.sum(axis=0) @ model.y_offset - B.sum(axis=0) @ model.u_offset
    return ARXModel(A=-W, B=B, c=c, nk=1 + first, dt=model.dt, inputs=model.inputs, outputs=model.outputs)


def longest(forms: list[ARXModel], errors: list[float]) -> int | None:
    """The place of the first whose squared error is about the least; None where none is finite."""
    least = min(errors, default=np.inf)
    return next((i for i in range(len(forms)) if errors[i] <= ALIKE * least), None) if np.isfinite(least) else None


def in_scaled(model: ARXModel, u: Scaling, y: Scaling) -> ARXModel:
    """The same model between scaled inputs and outputs."""
    A = model.A * y.factor / y.factor[:, None]
    B = model.B * u.factor / y.factor[:, None]
    rest = model.c - y.offset - model.A.sum(axis=0) @ y.offset + model.B.sum(axis=0) @ u.offset
    return replace(model, A=A, B=B, c=rest / y.factor, fit_info=None)
