"""Whether v_x is logged too large or too small, as by wheels of another radius, by what a car feels across."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.quality.regression import about_means, by_blocks, jackknife, sizes
from slipangle.data.quality.stuck import low_pass

_BODIES = 0.7, 1.5  # Hz, below which an accelerometer shows what the car's centre of gravity does; both have to tell
_EDGE = 1.0  # s at either end of a drive
_OFF, _SURE, _TOLD = 0.04, 2.5, 0.03  # of the speed, standard errors beside that, and error up to which it is told


def scaled(fast: Sequence[Dataset]) -> list[str]:
    """A sentence on the scale of v_x beside that of v_y, of drives with delta, v_x, v_y, r and a_y; SI units.

    a_y = v_x r + dv_y/dt, each times one factor where the body rolls: of the true speed, both terms are worth the same.
    """
    if not all(n in fast[0] for n in ("v_y", "a_y")):
        return []
    told = [_share(fast, below) for below in _BODIES]
    if any(error > _TOLD or abs(share - 1) < _OFF + _SURE * error for share, error in told):
        return []
    share = told[-1][0]
    return [
        f"v_x r is {1 / share:.3g} times what a_y and dv_y/dt make of it: v_x reads so many times the true speed, as "
        f"of wheels of another radius, or r does so (a gyro's scale), or v_y reads {share:.3g} times the true one; "
        "check v_x over a known distance, and r over a full circle"
    ]


def _share(fast: Sequence[Dataset], below: float) -> tuple[float, float]:
    """True over logged speed as a_y has it below so many Hz, and its standard error, of a jackknife over blocks. [-]

    v_y is told by steering and yaw rate (two-stage least squares), as noise of its rate would make it worth less.
    """
    tables, told = [], 0
    for part in fast:
        v, r, a_y, v_y, delta = (low_pass(part[n], part.dt, below) for n in ("v_x", "r", "a_y", "v_y", "delta"))
        r_dot, steered, edge = np.gradient(r, part.dt), np.gradient(delta, part.dt), round(_EDGE / part.dt)
        told_by = [v * r, r_dot, v, v * r_dot, v * v * r_dot, v * v * steered]
        made_of = [v * r, np.gradient(v_y, part.dt), r_dot, v]  # with levers of both sensors, and an offset of r
        tables.append(np.column_stack([*told_by, *made_of, a_y])[edge:-edge])
        told = len(told_by)
    drives = np.repeat(np.arange(len(tables)), [len(t) for t in tables])
    table = np.concatenate(tables)
    squares = by_blocks(np.column_stack([about_means(column, drives) for column in table.T]), drives)
    size = sizes(squares)

    def of(total: np.ndarray) -> float:
        first = np.linalg.lstsq(total[:told, :told], total[:told, told:-1], rcond=1e-10)[0].T
        found = np.linalg.lstsq(first @ total[:told, told:-1], first @ total[:told, -1], rcond=1e-10)[0]
        found = found / size[told:-1]
        return float(found[0] / found[1]) if found[1] > 0 else np.inf

    return jackknife(squares / np.outer(size, size), of)
