"""Which manoeuvre would identify what a log does not: by the Fisher information of each, simulated with the fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.quality.delay import STEERING
from slipangle.data.signals import excitation as excite
from slipangle.errors import ParameterError
from slipangle.identify.physics.simulation_error import FreeRunProblem, Minimum
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.numerics import covariance as uncertainty
from slipangle.shown import Shown

_LATERAL = ("v_y", "r", "beta", "delta_w", "a_y")  # states that are zero when driving straight
_SPEEDS = (0.6, 1.0, 1.4)  # of the log's median speed
_FASTER = 1.05  # highest speed over the log's
_HARDER = 1.5  # largest input over the largest one of the log
_GENTLE = 0.5 * GRAVITY  # lateral acceleration that every car holds on a dry road [m/s2]
_SIDEWAYS = 1.1  # largest lateral acceleration, and steering times speed squared, over those of the log
_ROBOT = 1.5  # how much better a manoeuvre that only a robot can steer must be than one that a driver can
_ROUNDING = 1e-14  # eigenvalue of an information matrix of ones on its diagonal over the largest, of no information
_NO_SHARE = 1e-6  # of a parameter in an eigenvector, up to which it is the rounding of zero
_FEWEST = 40  # samples of a manoeuvre
_HELPS = 0.7  # expected over present standard deviation, above which a manoeuvre is no advice

ABOUT_ZERO = ("offset", "bias", "delay", "lag", "compliance", "lever", "relaxation")
"""In names of parameters that may well be zero, so that an interval wider than the value is no fault."""
Wave = Callable[[int, float], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Advice(Shown):
    """What one manoeuvre, added to the log, is expected to do."""

    parameter: str  # the parameter it is ranked by
    manoeuvre: str  # what to drive
    before: float  # standard deviation of that parameter now and expected, SI units
    after: float  # standard deviation of that parameter now and expected, SI units
    unit: str  # of the parameter
    names: tuple[str, ...]  # all shared free parameters
    units: tuple[str, ...]  # their units
    present: np.ndarray  # (n_names,), their standard deviations now and expected
    std: np.ndarray  # (n_names,), their standard deviations now and expected
    data: Dataset  # the manoeuvre's inputs, and the outputs that the fitted model expects

    def _words(self) -> str:
        return self.sentence

    @property
    def helps(self) -> bool:
        """Whether it narrows the interval by a good part."""
        return self.after < _HELPS * self.before

    @property
    def sentence(self) -> str:
        """The advice in words."""
        return (
            f"drive {self.manoeuvre}: with it the standard deviation of {self.parameter} is expected to go from "
            f"{self.before:.2g} to {self.after:.2g} {self.unit}"
        )


def advise(
    model: Any, data: Dataset, *, parameter: str | None = None, duration: float = 20.0, harder: float = _HARDER
) -> tuple[Advice, ...]:
    """Manoeuvres ranked by how well they would determine a parameter, best first.

    Steps, sweeps, ramps and random binary sequences of every input, at several speeds where the speed is an input or a
    state, are simulated with the fitted model, each scaled so that it moves no output by more than the log did. The car
    must be able to drive them: no speed is above the log's by more than 5 %, no ``v_x r`` by more than 10 %. Steering
    times speed squared, which bounds the lateral acceleration even where the model is wrong, stays within 10 % of the
    log's too, or ``harder`` times that where it asks for less than 0.5 g. A manoeuvre's Fisher information, with the
    log's noise, is added to the log's own [1]_. What only a robot can steer ranks behind what a driver can, unless it
    is half as good again. All this holds near the fitted values: where those are far off, drive what is advised, fit
    again, and ask again.

    Raises ParameterError if the model is no fit, the parameter was not free, or the duration too short.

    Parameters
    ----------
    model : Parametrised
        As `GreyBox` or `Collocation` fitted it.
    data : Dataset
        The data it was fitted on.
    parameter : str, optional
        Which parameter to care about; by default the one with the largest relative standard deviation, of those that
        may not well be zero, as offsets, delays and places of sensors may.
    duration : float
        Of each manoeuvre, at least 40 samples. [s]
    harder : float
        Largest input of a manoeuvre over the log's.

    References
    ----------
    .. [1] L. Ljung, System Identification: Theory for the User, 2nd ed., Prentice Hall, 1999, secs. 7.4, 13.2.
    """
    info = model.fit_info
    if info is None:
        raise ParameterError("the model is no fit; expected one that GreyBox returned: fit it first")
    least = _FEWEST * model.dt
    if not least * (1 - 1e-9) <= duration < np.inf:
        raise ParameterError(
            f"a manoeuvre's duration is {duration:g} s; expected {least:g} s or more, {_FEWEST} samples"
        )
    shared = tuple(n for n in info.names if not n.endswith("]"))
    own = tuple(dict.fromkeys(n.partition("[")[0] for n in info.names if n.endswith("]")))
    if parameter is not None and parameter not in shared:
        raise ParameterError(f"'{parameter}' was not fitted for all experiments; expected one of {list(shared)}")
    problem = FreeRunProblem(model, shared, own, data, free_initial_state=False)
    problem.sigma = np.asarray(info.noise_std, dtype=float)
    z = np.clip(info.values / problem.scale, problem.lower, problem.upper)
    return rank(problem, problem.at(z), np.sqrt(np.diag(info.covariance)), parameter, duration, harder)


def rank(
    problem: FreeRunProblem,
    found: Minimum,
    std: np.ndarray,
    parameter: str | None = None,
    duration: float = 20.0,
    harder: float = _HARDER,
) -> tuple[Advice, ...]:
    """`advise` for a problem just solved; ``std`` is what the fit states."""
    k = len(problem.shared)
    if k == 0:
        return ()
    names, scale = problem.shared, problem.scale[:k]
    known, loss = _information(found, std, problem)
    values = found.z[:k] * scale
    if parameter is None:
        asked = np.array([not any(part in name for part in ABOUT_ZERO) for name in names])
        wide = std[:k] / np.maximum(np.abs(values), 0.02 * scale)
        parameter = names[int(np.argmax(np.where(asked, wide, -1.0) if asked.any() else wide))]
    j = names.index(parameter)
    before = _deviations(known) * scale
    result = []
    for text, rows, data in _candidates(problem, found, duration, harder):
        slopes = rows[1:, :, 1:] / found.sigma[:, None]
        block = slopes.reshape(-1, slopes.shape[2])[:, : len(problem.free)]
        widths = problem.scale[problem.columns(0)[: len(problem.free)]]
        more = _marginal(block.T @ block * np.outer(widths, widths), k) / np.outer(loss, loss)
        after = _deviations(known + more) * scale
        result.append(
            Advice(
                parameter=parameter,
                manoeuvre=text,
                before=float(before[j]),
                after=float(after[j]),
                unit=problem.model.si(parameter).unit,
                names=names,
                units=tuple(problem.model.si(n).unit for n in names),
                present=before,
                std=after,
                data=data,
            )
        )
    return _best_first(result)


def _best_first(advice: list[Advice]) -> tuple[Advice, ...]:
    return tuple(sorted(advice, key=lambda a: a.after * (_ROBOT if "binary" in a.manoeuvre else 1.0)))


def _information(found: Minimum, std: np.ndarray, problem: FreeRunProblem) -> tuple[np.ndarray, np.ndarray]:
    """Fisher information of the shared parameters in the log; how much wider coloured noise makes each interval."""
    k, dof = len(problem.shared), max(1, len(found.error) - found.jacobian.shape[1])
    white = _marginal(found.jacobian.T @ found.jacobian * dof / max(float(found.error @ found.error), 1e-300), k)
    stated, plain = std[:k] / problem.scale[:k], _deviations(white)
    fine = np.isfinite(stated) & np.isfinite(plain) & (stated > 0) & (plain > 0)
    loss = np.where(fine, stated, 1.0) / np.where(fine, plain, 1.0)
    return white / np.outer(loss, loss), loss


def _marginal(information: np.ndarray, k: int) -> np.ndarray:
    """Information about the first ``k`` unknowns when nothing is known of the others."""
    if len(information) == k:
        return information
    a, b, c = information[:k, :k], information[:k, k:], information[k:, k:]
    return a - b @ np.linalg.pinv(c, rcond=1e-12, hermitian=True) @ b.T


def _deviations(information: np.ndarray) -> np.ndarray:
    """Standard deviations that go with an information matrix; infinite where it has none."""
    lengths = np.sqrt(np.maximum(np.diag(information), 0.0))
    if not (lengths > 0).all():
        return np.full(len(lengths), np.inf)
    try:
        size, vectors = np.linalg.eigh(information / np.outer(lengths, lengths))
    except np.linalg.LinAlgError:
        return np.full(len(lengths), np.inf)
    none = size <= _ROUNDING * size[-1]
    loose = (np.abs(vectors[:, none]) > _NO_SHARE).any(axis=1)
    variance = (vectors[:, ~none] ** 2 / size[~none]).sum(axis=1)
    return np.where(loose, np.inf, np.sqrt(variance)) / lengths


# ---- manoeuvres ----------------------------------------------------------------------------------------------------


def _waves(dt: float) -> dict[str, Wave]:
    """Signals of amplitude 1 by name."""
    top = min(4.0, 0.25 / dt)
    low, middle = min(0.1, top / 8), min(0.5, top / 2)
    bit = max(1, round(0.4 / dt))

    def steps(n: int, dt: float) -> np.ndarray:
        return excite.staircase(n, dt, levels=(0.0, 1.0, 0.0, -1.0, 0.0, 0.5, -0.5, 0.0))

    def bits(n: int, dt: float) -> np.ndarray:
        return excite.prbs(n, hold=bit, seed=1)

    return {
        "a step of {}": partial(excite.step, start=1.0, rise=0.1),
        "steps of {} to both sides": steps,
        f"a sine sweep of {{}}, {low:.2g} to {top:.2g} Hz": partial(excite.swept_sine, f_start=low, f_stop=top),
        f"a sine sweep of {{}}, {middle:.2g} to {top:.2g} Hz": partial(excite.swept_sine, f_start=middle, f_stop=top),
        "a slow ramp of {}": lambda n, dt: excite.time(n, dt) / max((n - 1) * dt, dt),
        f"a random binary sequence of {{}}, {bit * dt:.2g} s a bit": bits,
    }


def _candidates(
    problem: FreeRunProblem, found: Minimum, duration: float, harder: float
) -> Iterator[tuple[str, np.ndarray, Dataset]]:
    """Text, simulated outputs with their derivatives, and data of every manoeuvre that can be driven."""
    model, data = problem.model, problem.data
    dt, m = model.dt, model.memory
    n = max(int(duration / dt), _FEWEST) + m
    speed = float(np.median(data["v_x"])) if "v_x" in data else None
    moving = [name for name in model.inputs if name not in ("v_x", "v_x_dot")]
    rest = {name: float(np.median(data[name])) for name in model.inputs} | {"v_x_dot": 0.0}
    fast = speed is not None and "v_x" in (*model.inputs, *model.ode.states)
    waves = {text: wave(n, dt) for text, wave in _waves(dt).items()}
    for name in moving:
        most = harder * float(np.abs(data[name] - rest[name]).max())
        unit = data.unit(name)
        for share in _shares(data) if fast else (1.0,):
            inputs = {c: np.full(n, v) for c, v in rest.items() if c in model.inputs}
            where = ""
            if fast and speed is not None:
                where = f" at {share * speed:.3g} m/s"
                if "v_x" in inputs:
                    inputs["v_x"] = np.full(n, share * speed)
            now = abs(share * speed) if speed is not None else None
            trial = _Trial(problem, found, inputs, _straight(problem, share), name, now)
            size = min(most, trial.steered(rest[name], harder))
            for text, wave in waves.items():
                driven = trial.within_range(wave, size)
                if driven is not None:
                    rows, made, used = driven
                    what = text.format(f"{name} (±{used:.2g}{'' if unit == '-' else ' ' + unit})")
                    states = model.ode.states
                    extra = {"v_x": np.full(n, trial.x0[states.index("v_x")])} if "v_x" in states else {}
                    seen = zip(model.outputs, rows[:, :, 0].T, strict=True)
                    outputs = {o: np.concatenate([np.full(m - 1, y[0]), y]) for o, y in seen}
                    extra = {c: v for c, v in extra.items() if c not in outputs}
                    units = {c: data.unit(c) for c in (*made, *outputs)}
                    log = Dataset.from_arrays(made, outputs, dt, extra=extra, units=units, name="manoeuvre")
                    yield f"{what}{where} for {(n - m) * dt:.3g} s", rows, log


def _shares(data: Dataset) -> list[float]:
    """Speeds over the median one, none beyond what the car did."""
    speed = np.abs(data["v_x"])
    most = _FASTER * float(speed.max()) / max(float(np.median(speed)), 1e-12)
    return sorted({min(share, most) for share in _SPEEDS})


def _straight(problem: FreeRunProblem, share: float) -> np.ndarray:
    """State at the start of a manoeuvre: that of the log's first sample, straight, at a share of its speed."""
    x = problem.fixed_x0[0].copy()
    for j, name in enumerate(problem.model.ode.states):
        if name in _LATERAL:
            x[j] = 0.0
        elif name == "v_x" or name.startswith("omega"):
            x[j] *= share
    return x


class _Trial:
    """Manoeuvres of one input from one state, the other inputs at rest."""

    def __init__(
        self,
        problem: FreeRunProblem,
        found: Minimum,
        inputs: dict[str, np.ndarray],
        x0: np.ndarray,
        name: str,
        speed: float | None,
    ) -> None:
        self.problem, self.inputs, self.x0, self.name, self.speed = problem, inputs, x0, name, speed
        self.p = problem.parameters(0, found.z)
        y = problem.data.y
        self.seen = np.maximum(np.abs(y - np.median(y, axis=0)).max(axis=0), 1e-12)
        outputs, data = list(problem.model.outputs), problem.data
        if "r" in outputs and speed and "v_x" in data:  # the car need not hold at 30 m/s the yaw rate of a hairpin
            j = outputs.index("r")
            turn = _SIDEWAYS * float(np.abs(data["v_x"] * data["r"]).max()) / speed
            self.seen[j] = max(min(self.seen[j], turn), 1e-12)
        self.undriven = self._run(inputs)[:, :, 0]

    def steered(self, rest: float, harder: float) -> float:
        """Largest steering that the log's lateral acceleration allows at this speed, whatever the model makes of it."""
        data = self.problem.data
        if self.name not in STEERING or not self.speed or "v_x" not in data:
            return float("inf")
        asked = float((np.abs(data[self.name] - rest) * data["v_x"] ** 2).max())
        model = self.problem.model
        gentle = _GENTLE * model.value("wheelbase") if "wheelbase" in model.parameter_names else 0.0
        return max(_SIDEWAYS * asked, min(harder * asked, gentle)) / self.speed**2

    def _run(self, made: dict[str, np.ndarray]) -> np.ndarray:
        model, n = self.problem.model, len(made[self.name])
        empty = {o: np.zeros(n) for o in model.outputs if o not in made}
        rows = model.drive_rows(Dataset.from_arrays(made, empty, model.dt).select(inputs=model.inputs))
        with np.errstate(all="ignore"):
            return self.problem.run(self.x0, np.zeros((self.problem.n_x, len(self.p))), rows, self.p)

    def within_range(self, wave: np.ndarray, most: float) -> tuple[np.ndarray, dict[str, np.ndarray], float] | None:
        """Outputs, inputs and size of the largest manoeuvre that the log allows; None where none stays finite."""
        size = most
        for _ in range(6):
            made = self.inputs | {self.name: self.inputs[self.name] + size * wave}
            rows = self._run(made)
            excess = float((np.abs(rows[:, :, 0] - self.undriven).max(axis=0) / self.seen).max())
            if np.isfinite(rows).all() and excess <= 1.05:
                return rows, made, size
            size *= max(0.1, 1 / excess) if np.isfinite(excess) else 0.3
        return None


def better_sentences(problem: FreeRunProblem, found: Minimum, values: np.ndarray, std: np.ndarray) -> dict[str, str]:
    """For each shared parameter that the data do not determine, what to drive."""
    k = len(problem.shared)
    poor = uncertainty.undetermined(values[:k], std[:k], problem.scale[:k])
    said: dict[str, str] = {}
    if not poor.any():
        return said
    every = rank(problem, found, std)
    none = f"look elsewhere: none of {len(every)} manoeuvres of this size helps"
    for j in np.flatnonzero(poor & (std[:k] > 0)):
        name = problem.shared[j]
        of_name = {"parameter": name, "unit": problem.model.si(name).unit}
        ranked = [replace(a, before=float(a.present[j]), after=float(a.std[j]), **of_name) for a in every]
        best = next((a for a in _best_first(ranked) if a.helps), None)
        said[name] = best.sentence if best else none
    return said
