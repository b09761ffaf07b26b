"""State spaces of inputs that act at once, or late: what is fitted to inputs of before keeps them as states."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import linalg

from slipangle.data.dataset import Dataset
from slipangle.errors import SlipangleError
from slipangle.identify.linear.delays import delayed, first_effects
from slipangle.identify.linear.order_search import Judged
from slipangle.identify.stability import breakdown_said
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.provenance import provenance
from slipangle.numerics.blas import one_blas_thread

_LONG, _SPARE = 4, 3  # samples of delay that are states like others; of a longer one, how many stay so


def settled(settings: Any, data: Dataset) -> tuple[Any, dict[str, int]]:
    """A state space's settings with a direct path or none, and samples by which each input waits beside its states.

    What the data tell is taken where the best subspace model of all orders does better for it on held-out data.
    """
    best, waits = replace(settings, direct=False), dict.fromkeys(data.inputs, 0)
    first = dict(zip(data.inputs, first_effects(data, data.inputs), strict=True))
    late = {name: k - _SPARE if k > _LONG else 0 for name, k in first.items()}
    options = [False] * any(late.values()) + [True] * (0 in first.values())
    judged = _best_start(best, data) if options else None
    for direct in options:
        other, by = replace(settings, direct=direct), waits if direct else late
        its = _best_start(other, delayed(data, by))
        if its is not None and (judged is None or its.beats(judged)):
            best, waits, judged = other, by, its
    return best, waits


def said(direct: bool, waits: Mapping[str, int]) -> str:
    """What was settled, for the method's line; empty where that is nothing."""
    late = ", ".join(f"{name} {samples} samples late" for name, samples in waits.items() if samples)
    return "".join(f"{words}; " for words in ("direct path" * direct, late) if words)


def _best_start(settings: Any, data: Dataset) -> Judged | None:
    """How the best subspace model of all orders does on held-out data; None where there is none."""
    seen, parts, _ = settings._held_out(data)
    starts, _ = settings._starts(seen, parts, settings._orders, {})
    found: list[Judged] = []
    for pair in starts.values():
        with suppress(SlipangleError), breakdown_said("the state space", data), one_blas_thread():
            found.append(settings._judged(*pair, parts))
    return min((j for j in found if np.isfinite(j.error)), key=lambda j: j.error, default=None)


def waiting(model: StateSpaceModel, by: Mapping[str, int], data: Dataset) -> StateSpaceModel:
    """The model with some inputs acting so many samples later, which wait in states behind its own.

    Entries of B and D of an input that waits become entries of A and C, also in ``fit_info``, whose data are ``data``.
    """
    late = {model.inputs.index(name): samples for name, samples in by.items() if samples}
    if not late:
        return model
    n, ends, at = model.order, dict[int, int](), model.order
    lines = []
    for i, samples in late.items():
        lines.append(np.eye(samples, k=-1))
        ends[i] = at + samples - 1  # the state that holds the oldest
        at += samples
    A = np.array(linalg.block_diag(model.A, *lines))
    B = np.zeros((at, model.n_inputs))
    B[:n] = model.B
    C, D = np.zeros((model.n_outputs, at)), np.array(model.D)
    C[:, :n] = model.C
    for i, end in ends.items():
        A[:n, end], C[:, end] = model.B[:, i], model.D[:, i]
        B[:n, i], B[end - late[i] + 1, i], D[:, i] = 0.0, 1.0, 0.0
    K = np.vstack([model.K, np.zeros((at - n, model.n_outputs))])
    info = model.fit_info
    if info is not None:
        info = replace(info, names=tuple(_moved(name, ends) for name in info.names), **provenance(data))
    memory = model.memory + max(late.values())
    return replace(model, A=A, B=B, C=C, D=D, K=K, x0=None, memory=memory, fit_info=info)


def _moved(name: str, ends: Mapping[int, int]) -> str:
    """The name of an entry that is at another place now."""
    what, _, place = name.partition("[")
    if what not in ("B", "D"):
        return name
    row, column = (int(k) for k in place[:-1].split(","))
    return f"{'A' if what == 'B' else 'C'}[{row},{ends[column]}]" if column in ends else name
