"""The competitor: a single-track model written by hand and fitted with `scipy.optimize.least_squares`.

What a competent engineer writes in an afternoon, in plain NumPy and SciPy: steering gain, offset, pure delay and
first-order lag, C_f, C_r, yaw inertia, and tires that saturate, ``F = mu F_z tanh(C alpha / (mu F_z))`` per axle. All
experiments and all varied parameter sets of a Jacobian run side by side as columns. Where the sensor
of v_y sits before the centre of gravity is one more unknown, if asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import signal
from scipy.optimize import least_squares

from slipangle.data.dataset import Dataset

NAMES = ("C_f", "C_r", "inertia_z", "mu_f", "mu_r", "steering_gain", "steering_offset", "delay", "lag", "sensor_x")
G = 9.81  # m/s2
LONGEST = 0.3  # s, delay and lag


@dataclass(frozen=True, kw_only=True)
class Known:
    """What the user measured. [kg, m, m]"""

    mass: float
    wheelbase: float
    l_f: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """Experiments side by side, shape (n_samples, n_experiments); short ones are continued and not counted."""

    dt: float
    delta: np.ndarray
    v_x: np.ndarray
    measured: dict[str, np.ndarray]  # by output, NaN where there is no sample

    @classmethod
    def of(cls, data: Dataset, outputs: Sequence[str], every: int = 1) -> Log:
        """Every so many samples of a data set."""
        parts = [np.column_stack([part[n] for n in ("delta", "v_x", *outputs)])[::every] for part in data.experiments]
        longest = max(map(len, parts))
        table = np.stack([np.pad(p, [(0, longest - len(p)), (0, 0)], "edge") for p in parts], axis=1)
        unused = np.arange(longest)[:, None] >= np.array([len(p) for p in parts])
        measured = {n: np.where(unused, np.nan, table[..., 2 + i]) for i, n in enumerate(outputs)}
        return cls(dt=every * data.dt, delta=table[..., 0], v_x=table[..., 1], measured=measured)

    @cached_property
    def speed(self) -> np.ndarray:
        """Speed without its sensor's noise: the mean of the samples within 0.15 s."""
        n = max(round(0.15 / self.dt), 1)
        padded = np.pad(self.v_x, [(n, n), (0, 0)], "edge")
        total = np.cumsum(np.vstack([np.zeros((1, padded.shape[1])), padded]), axis=0)
        return np.maximum((total[2 * n + 1 :] - total[: -2 * n - 1]) / (2 * n + 1), 0.05)


def run(known: Known, sets: np.ndarray, log: Log) -> tuple[np.ndarray, np.ndarray]:
    """v_y [m/s] and r [rad/s] of free runs, shape (n_samples, n_sets, n_experiments); a row of parameters per set."""
    h, (n, experiments) = log.dt, log.delta.shape
    p = {name: np.repeat(column, experiments) for name, column in zip(NAMES, sets.T, strict=True)}
    a, b = known.l_f, known.wheelbase - known.l_f
    grip_f, grip_r = (p[mu] * known.mass * G * arm / known.wheelbase for mu, arm in (("mu_f", b), ("mu_r", a)))
    slope = np.stack([p["C_f"] / grip_f, p["C_r"] / grip_r])
    by_front = np.stack([grip_f / known.mass, a * grip_f / p["inertia_z"]])  # rates of v_y and r by a sliding axle
    by_rear = np.stack([grip_r / known.mass, -b * grip_r / p["inertia_z"]])
    motion = np.array([[-1.0, -a], [-1.0, b]])  # slip speeds of the axles by v_y and r

    def rate(x: np.ndarray, angle: np.ndarray, v: np.ndarray) -> np.ndarray:
        alpha = motion @ x / v
        alpha[0] += angle
        used = np.tanh(alpha * slope)
        change = by_front * used[0] + by_rear * used[1]
        change[0] -= v * x[1]
        return change

    angles = _road_wheel(sets, log)
    v = np.tile(log.speed, len(sets))
    between = [0.5 * (y[:-1] + y[1:]) for y in (angles, v)]
    first = (np.nan_to_num(log.measured[o][0]) if o in log.measured else np.zeros(experiments) for o in ("v_y", "r"))
    x = np.tile(np.stack(list(first)), len(sets))
    out = np.empty((n, 2, len(sets) * experiments))
    out[0] = x
    for k in range(n - 1):
        k1 = rate(x, angles[k], v[k])
        k2 = rate(x + 0.5 * h * k1, between[0][k], between[1][k])
        k3 = rate(x + 0.5 * h * k2, between[0][k], between[1][k])
        k4 = rate(x + h * k3, angles[k + 1], v[k + 1])
        out[k + 1] = x = x + h / 6 * (k1 + 2 * (k2 + k3) + k4)
    v_y, r = out[:, 0] + p["sensor_x"] * out[:, 1], out[:, 1]
    return v_y.reshape(n, len(sets), experiments), r.reshape(n, len(sets), experiments)


def _road_wheel(sets: np.ndarray, log: Log) -> np.ndarray:
    """Angle at the wheels, shape (n_samples, n_sets * n_experiments): late, filtered, scaled."""
    at, columns = np.arange(len(log.delta)), []
    for one in sets:
        p = dict(zip(NAMES, one, strict=True))
        late = np.column_stack([np.interp(at - p["delay"] / log.dt, at, column) for column in log.delta.T])
        lag = max(p["lag"], 1e-5)
        decay = np.exp(-log.dt / lag)
        rest = (1 - decay) * lag / log.dt  # exact for what is straight between samples
        kept = rest * late[:1]  # as if the first angle had been held for ever
        slow, _ = signal.lfilter([1 - rest, rest - decay], [1, -decay], late, axis=0, zi=kept)
        columns.append(p["steering_gain"] * (slow - p["steering_offset"]))
    return np.hstack(columns)


@dataclass(frozen=True, kw_only=True, eq=False)
class ScipyFit:
    """A fitted single track."""

    known: Known
    outputs: tuple[str, ...]
    values: dict[str, float]
    std: dict[str, float]  # as if the residuals were white
    cost: float

    def simulate(self, data: Dataset) -> np.ndarray:
        """Free run from the first sample of each experiment, shape (n_samples, n_outputs)."""
        log = Log.of(data, self.outputs)
        v_y, r = run(self.known, np.array([list(self.values.values())]), log)
        columns = {"v_y": v_y[:, 0], "r": r[:, 0]}
        lengths = [b - a for a, b in zip(data.starts, data.stops, strict=True)]
        return np.vstack([np.column_stack([columns[o][:m, i] for o in self.outputs]) for i, m in enumerate(lengths)])


def fit(data: Dataset, known: Known, outputs: Sequence[str] = ("v_y", "r"), *, sensor_free: bool = False) -> ScipyFit:
    """The best of a few starts on half the samples, then all of them, each output over its residuals' size."""
    every = 2 if data.dt < 0.015 else 1
    coarse, full = Log.of(data, outputs, every), Log.of(data, outputs)
    scale = {o: float(np.nanstd(full.measured[o])) for o in outputs}
    free = np.array([n != "sensor_x" or sensor_free for n in NAMES])
    trials = [_solve(known, coarse, scale, start, free, 12) for start in _starts()]
    best = min(trials, key=lambda found: found[1])
    for _ in range(2):
        parts = np.split(best[3][: -len(_HELD)], _ends(coarse, outputs))
        sizes = np.sqrt([np.mean(part**2) for part in parts])
        scale = {o: scale[o] * size for o, size in zip(outputs, sizes, strict=True)}
        best = _solve(known, coarse, scale, best[0], free, 25)
    x, cost, jacobian, residuals = _solve(known, full, scale, best[0], free, 30)
    noise = np.sum(residuals**2) / max(len(residuals) - len(x), 1)
    spread = np.zeros(len(NAMES))
    spread[free] = np.sqrt(np.maximum(np.diag(noise * np.linalg.pinv(jacobian.T @ jacobian)), 0.0))
    values = _parameters(known, x[None])[0]
    size = np.where(_LOG, values, 1.0)
    return ScipyFit(
        known=known,
        outputs=tuple(outputs),
        values=dict(zip(NAMES, map(float, values), strict=True)),
        std=dict(zip(NAMES, map(float, spread * size), strict=True)),
        cost=cost,
    )


# ---- unknowns: logarithms over a guess from mass and size, and the rest as it is ------------------------------------

_LOG = np.array([True] * 5 + [False] * 5)
_LOW = np.array([-4.0, -4.0, -2.0, -3.0, -3.0, 0.2, -0.2, 0.0, 0.0, -5.0])
_HIGH = np.array([4.0, 4.0, 2.0, 2.0, 2.0, 5.0, 0.2, LONGEST, LONGEST, 5.0])
_STEP = np.array([1e-4] * 5 + [1e-4, 1e-5, 1e-4, 1e-4, 1e-4])
_HELD = [0, 1, 2, 3, 4]  # what is pulled to the guess, so that it stays on the ground where the log tells little
_SPREAD = np.array([0.7, 0.7, 0.3, 0.4, 0.4])
_PULL = 0.08  # one spread off costs as much as 0.6 % more squared error
_SIZE = np.array([0.3] * 5 + [0.1, 0.01, 0.03, 0.03, 0.1])


def _ends(log: Log, outputs: Sequence[str]) -> np.ndarray:
    """Where the residuals of the next output begin."""
    return np.cumsum([np.isfinite(log.measured[o]).sum() for o in outputs])[:-1]


def _guess(known: Known) -> np.ndarray:
    a, b = known.l_f, known.wheelbase - known.l_f
    loads = known.mass * G * np.array([b, a]) / known.wheelbase
    return np.array([15 * loads[0], 15 * loads[1], known.mass * a * b, 1.0, 1.0])


def _starts() -> list[np.ndarray]:
    common = [0.0, 0.0, 0.0, 1.0, 0.0]  # inertia, friction, gain, offset
    return [
        np.array([stiff, stiff + 0.1, *common, delay, lag, 0.0])
        for stiff, delay, lag in ((0.0, 0.02, 0.03), (0.6, 0.06, 0.08), (-0.6, 0.005, 0.01))
    ]


def _parameters(known: Known, x: np.ndarray) -> np.ndarray:
    sets = x.copy()
    sets[:, :5] = _guess(known) * np.exp(x[:, :5])
    return sets


def _solve(
    known: Known, log: Log, scale: dict[str, float], start: np.ndarray, free: np.ndarray, evaluations: int
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Unknowns, cost, Jacobian by the free ones and residuals of a local search; a Jacobian is one free run."""
    cells = {o: np.isfinite(log.measured[o]) for o in scale}

    def residuals(x: np.ndarray) -> np.ndarray:
        """Shape (n_residuals, n_sets)."""
        columns = dict(zip(("v_y", "r"), run(known, _parameters(known, x), log), strict=True))
        rows = []
        for o, size in scale.items():
            error = (columns[o] - np.nan_to_num(log.measured[o])[:, None]) / size
            rows.append(error.transpose(0, 2, 1)[cells[o]])
        fits = np.concatenate(rows)
        held = _PULL * np.sqrt(len(fits)) * x[:, _HELD].T / _SPREAD[:, None]
        return np.nan_to_num(np.clip(np.concatenate([fits, held]), -1e3, 1e3), nan=1e3)

    last: dict[str, np.ndarray] = {}

    def one(z: np.ndarray) -> np.ndarray:
        """Residuals, with their derivatives by differences from the same run."""
        x = np.array(start)
        x[free] = z
        steps = np.where(x + _STEP < _HIGH, _STEP, -_STEP)
        every = residuals(np.vstack([x, x + np.diag(steps)[free]]))
        last["jacobian"] = (every[:, 1:] - every[:, :1]) / steps[free]
        return every[:, 0]

    found = least_squares(
        one,
        np.clip(start, _LOW + 1e-6, _HIGH - 1e-6)[free],
        jac=lambda z: last["jacobian"],
        bounds=(_LOW[free], _HIGH[free]),
        x_scale=_SIZE[free],
        max_nfev=evaluations,
        ftol=1e-6,
        xtol=1e-6,
    )
    x = np.array(start)
    x[free] = found.x
    return x, float(found.cost), np.asarray(found.jac), found.fun
