"""`plan_many`: plans of one controller from many states, over the cores of the machine."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from slipangle.control.controller import Ahead, Controller
from slipangle.errors import ParameterError
from slipangle.optimal.arrays import array, short
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import Plan
from slipangle.paths.preview import Preview


def plan_many(
    controller: Controller,
    x: np.ndarray,
    reference: Ahead | Sequence[Ahead] | None,
    previous: Sequence[Any] | None,
    applied: np.ndarray | None,
    threads: int | None,
    values: Mapping[str, Any],
    said: Callable[[Ahead | None, dict[str, Any]], Reference],
) -> list[Plan]:
    """See `slipangle.control.mpc.MPC.plan_many`; ``said`` makes the reference of one plan from values by name."""
    given = np.asarray(x, dtype=float) if np.ndim(x) == 2 else None
    if given is None:
        raise ParameterError(
            f"x is {short(x)}; expected states of shape (n, {len(controller.model.states)}), one row for each plan"
        )
    n = len(given)
    states = array(given, (n, len(controller.model.states)), controller.model.states, "x")
    if reference is None or values:
        references = _said_of_each(values, n, reference, said)
    elif isinstance(reference, Reference | Preview):
        references = [reference] * n
    else:
        references = _one_each(reference, n, "reference")
    before = [None] * n if previous is None else _one_each(previous, n, "previous")
    inputs: Sequence[Any] = [None] * n
    if applied is not None:
        inputs = list(array(applied, (n, len(controller.controls)), controller.controls, "applied"))
    if threads is not None and not (isinstance(threads, int | np.integer) and threads >= 1):
        raise ParameterError(f"threads is {short(threads)}; expected a whole number of at least 1")
    many = max(1, min(threads or os.cpu_count() or 1, n))

    def part(rows: np.ndarray) -> list[Plan]:
        return [controller.plan(states[i], references[i], before[i], applied=inputs[i]) for i in rows]

    parts = np.array_split(np.arange(n), many)
    if many == 1:
        return part(parts[0])
    with ThreadPoolExecutor(many) as pool:
        return [plan for found in pool.map(part, parts) for plan in found]


def _said_of_each(
    values: Mapping[str, Any], n: int, reference: Any, said: Callable[[Any, dict[str, Any]], Reference]
) -> list[Reference]:
    """The reference of each plan, from values that all share or that have an entry, or a row, for each.

    Raises
    ------
    ParameterError
        If there is a reference too, or there is not one of each.
    """
    shared, each = {}, {}
    for name, value in values.items():
        several = isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim > 0)
        if not several:
            shared[name] = value
        elif len(value) == 1:
            shared[name] = value[0]
        elif len(value) == n:
            each[name] = value
        else:
            raise ParameterError(
                f"'{name}' has {len(value)} entries; expected one, or one for each of the {n} states: give what all "
                f"follow over the horizon as one row, {name}=[values]"
            )
    if not each:
        return [said(reference, shared)] * n
    return [said(reference, shared | {name: value[i] for name, value in each.items()}) for i in range(n)]


def _one_each(given: Any, n: int, what: str) -> Sequence[Any]:
    """A sequence with an entry for each state.

    Raises
    ------
    ParameterError
        If it is none, or of another length.
    """
    if not isinstance(given, Sequence) or len(given) != n:
        size = f"has {len(given)} entries" if isinstance(given, Sequence) else f"is {short(given)}"
        raise ParameterError(f"{what} {size}; expected one for each of the {n} states")
    return given
