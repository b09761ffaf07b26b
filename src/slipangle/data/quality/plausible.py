"""Whether the channels of a car's log agree with each other: signs, units, clocks, sensors that stick."""

from __future__ import annotations

import numpy as np
from scipy import signal

from slipangle.data.dataset import Dataset
from slipangle.data.quality.inspect import resting

_SLOW = 0.7  # Hz, below which a car nearly follows its steering
# Share of the logged angle that the motion asks for, about half of the truth to all of it where lags are long, and what
# explains it.
_SHARES = (
    (0.0, 0.024, "delta is logged in degrees: declare its unit as deg"),
    (0.024, 0.115, "delta is the angle of the hand wheel: give the steering ratio, about {ratio:.0f}"),
    (
        0.115,
        0.36,
        "v_x is logged in km/h: declare its unit as km/h, or delta is a command: give steering_gain, about {gain:.2g}",
    ),
    (15.0, 120.0, "r is logged in deg/s: declare its unit as deg/s"),
)
_SPEEDS = 0.2  # range of speeds over their mean, from which understeer and offsets show
_MOVING = 0.3  # share of the steering's variance inside drives, from which they tell the gain by themselves
_STUCK, _LATE = 1.0, 0.15  # s
_ZERO, _BLOCKS = 0.09, 12  # offset of r [rad/s] that a fit hardly reaches, and blocks of a drive
LONGEST_STEP = 0.5  # s, between samples of a car that is steered


def doubts(data: Dataset, *, wheelbase: float) -> tuple[str, ...]:
    """Sentences about channels that contradict each other, each with what to change; none for a sound log.

    Kinematics ties delta, v_x and r together, ``r wheelbase / v_x = gain delta`` at low speed, and v_x, r and a_y,
    ``a_y = v_x r`` in steady cornering. ``data`` has delta [rad], v_x [m/s], r [rad/s], and v_y, a_y where measured;
    ``wheelbase`` is in m.
    """
    if data.dt > LONGEST_STEP:
        return (
            f"samples are {data.dt:.3g} s apart; expected less than {LONGEST_STEP:g} s of a car that is steered: if "
            "time is logged in milliseconds (ms), declare its unit as ms",
        )
    said = [*_stuck(data)]
    fast = [part for part in data.experiments if part.n_samples * part.dt > 4.0]
    if not fast:
        return tuple(said)
    smooth = {n: np.concatenate([_low_pass(p[n], p.dt) for p in fast]) for n in data.names if _numeric(data, n)}
    turn = smooth["v_x"] * smooth["r"]
    cornering, about_r = _cornering(data, fast, smooth, turn)
    said += cornering
    if not about_r:
        drives = np.repeat(np.arange(len(fast)), [part.n_samples for part in fast])
        said += _steering(smooth, wheelbase, drives) or _zero(smooth, drives)
    return tuple(said)


def _numeric(data: Dataset, name: str) -> bool:
    return name in ("delta", "v_x", "r", "v_y", "a_y")


def _low_pass(x: np.ndarray, dt: float) -> np.ndarray:
    return signal.sosfiltfilt(signal.butter(2, min(2 * dt * _SLOW, 0.9), output="sos"), x)


def _slope(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope of y over x, and their correlation."""
    x, y = x - x.mean(), y - y.mean()
    power = float(x @ x)
    if power <= 0 or not y.any():
        return 0.0, 0.0
    return float(x @ y) / power, float(x @ y / np.sqrt(power * (y @ y)))


def _cornering(
    data: Dataset, fast: list[Dataset], smooth: dict[str, np.ndarray], turn: np.ndarray
) -> tuple[list[str], bool]:
    """Sentences on a_y beside v_x r, and whether one says that v_x, r or their units are wrong."""
    if "a_y" not in data:
        return [], False
    slope, agree = _slope(turn, smooth["a_y"])
    if "v_y" in data and abs(agree) < 0.7:
        other, agree_y = _slope(turn, smooth["v_y"])
        if agree_y > 0.9 and 0.5 < other < 2:
            return ["v_y moves as a_y should, as v_x r does, and a_y does not: v_y and a_y are swapped"], False
    if agree < -0.7:
        return ["a_y moves against v_x r: r or a_y has the wrong sign; expected axes of ISO 8855, y left"], False
    late = _late(fast)
    if late > _LATE:
        return [f"r comes {late:.2f} s behind a_y: it is logged late; shift it, or take another sensor"], True
    if agree < 0.7:
        return [], False
    if 2.6 < 1 / slope < 4.6:
        return [f"a_y is {slope:.2g} of v_x r: v_x is logged in km/h; declare its unit as km/h"], True
    if 30 < 1 / slope < 110:
        return [f"a_y is {slope:.2g} of v_x r: r is logged in deg/s; declare its unit as deg/s"], True
    if 6 < 1 / slope < 14:
        return [f"a_y is {slope:.2g} of v_x r: a_y is logged in g; declare its unit as g"], False
    return [], False


def _late(fast: list[Dataset]) -> float:
    """How long v_x r comes after a_y. [s]"""
    dt, most = fast[0].dt, round(0.6 / fast[0].dt)
    total = np.zeros(2 * most + 1)
    for part in fast:
        x, y = (signal.detrend(v) for v in (part["a_y"], part["v_x"] * part["r"]))
        full = signal.correlate(y, x, mode="full")
        middle = len(x) - 1
        total += full[middle - most : middle + most + 1] / (np.linalg.norm(x) * np.linalg.norm(y) + 1e-300)
    return float((int(np.argmax(total)) - most) * dt)


def _steering(smooth: dict[str, np.ndarray], wheelbase: float, drives: np.ndarray) -> list[str]:
    """Sentences on delta beside r wheelbase / v_x; ``drives`` numbers the experiment of each sample.

    Each drive has an offset of its own, as its steering sensor may, where the steering moves enough inside drives.
    """
    v, r, delta = smooth["v_x"], smooth["r"], smooth["delta"]
    fast = v > 0.3 * np.quantile(v, 0.9)
    v, r, delta, drives = v[fast], r[fast], delta[fast], drives[fast]
    asked = r * wheelbase / v
    _, agree = _slope(delta, asked)
    if agree < -0.6:
        return [
            f"r moves against delta (agreement {agree:.2f}): one has the wrong sign; set sign = -1 for delta, left is "
            "positive"
        ]
    if agree < 0.4:
        return []
    inside = _inside(delta, drives)
    if np.sum(inside**2) < _MOVING * np.sum((delta - delta.mean()) ** 2):
        drives = np.zeros_like(drives)
    columns, speeds = [delta], float(np.ptp(v)) > _SPEEDS * float(v.mean())
    if speeds:  # understeer, which at one speed cannot be told from the steering's gain
        columns.append(-v * r * wheelbase)
    table = np.column_stack([_inside(column, drives) for column in columns])
    scale = np.maximum(np.abs(table).max(axis=0), 1e-300)
    gain = float(np.linalg.lstsq(table / scale, _inside(asked, drives), rcond=None)[0][0] / scale[0])
    return [
        f"r wheelbase / v_x is about {gain:.2g} of delta: {words.format(ratio=0.8 / gain, gain=gain / 0.8)}"
        for low, high, words in _SHARES
        if low < gain <= high and (speeds or "km/h" not in words)
    ]


def _inside(x: np.ndarray, drives: np.ndarray) -> np.ndarray:
    """The signal about its mean in each drive."""
    count = np.maximum(np.bincount(drives), 1)
    return x - (np.bincount(drives, x) / count)[drives]


def _zero(smooth: dict[str, np.ndarray], drives: np.ndarray) -> list[str]:
    """A sentence on an offset of r beyond what a fit corrects: what delta, v_x and understeer do not explain.

    An offset of the steering counts for more the faster the car is, one of the sensor does not; its standard error is
    that of a jackknife over blocks of the drive (R. G. Miller, The jackknife: a review, Biometrika 61, 1974).
    """
    v, r, delta = smooth["v_x"], smooth["r"], smooth["delta"]
    if np.ptp(v) < _SPEEDS * v.mean():  # at one speed, offsets of delta and r are one
        return []
    table = np.column_stack([v * delta, v * v * r, v, np.ones(len(v)), r])
    rows = np.split(table, np.flatnonzero(np.diff(drives)) + 1)
    blocks = [b for part in rows for b in np.array_split(part, max(1, _BLOCKS // len(rows)))]
    squares = np.array([b.T @ b for b in blocks])
    size = np.sqrt(np.maximum(np.diagonal(squares.sum(axis=0)), 1e-300))
    squares /= np.outer(size, size)

    def offset(total: np.ndarray) -> float:
        return float(np.linalg.lstsq(total[:4, :4], total[:4, 4], rcond=1e-9)[0][3] * size[4] / size[3])

    whole, n = squares.sum(axis=0), len(blocks)
    value, others = offset(whole), np.array([offset(whole - one) for one in squares])
    error = float(np.sqrt((n - 1) / n * np.sum((others - others.mean()) ** 2))) if n > 3 else np.inf
    if abs(value) < max(_ZERO, 5 * error):
        return []
    return [f"r reads {value:.2g} rad/s on a straight: its sensor has an offset; subtract it"]


def _stuck(data: Dataset) -> list[str]:
    """Sensors that stay at one value while the car is steered."""
    said, steers, fastest = [], 0.2 * np.std(data["delta"]), 0.3 * np.max(data["v_x"])
    experiments = set(zip(data.starts, data.stops, strict=True))
    for name in ("r", "v_y", "a_y", "v_x"):
        if name not in data or np.ptp(data[name]) == 0:
            continue
        longest = 0.0
        for a, b in resting(data, name):
            whole = name == "v_x" and (a, b) in experiments  # driven, or simulated, at one speed
            if not whole and np.ptp(data["delta"][a:b]) > steers and np.max(data["v_x"][a:b]) > fastest:
                longest = max(longest, (b - a - 1) * data.dt)
        if longest > _STUCK:
            said.append(
                f"{name} is stuck at one value for {longest:.2g} s while the car is steered: cut that out, or mend the "
                "sensor"
            )
    return said
