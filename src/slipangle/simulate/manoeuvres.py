"""Manoeuvres: steering and speed over time to excite and test a plant, and paths with a speed profile to follow.

Lane changes of ISO 3888 are in `slipangle.paths.lane_change`, steering signals in `slipangle.data.signals.excitation`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Annotated

import numpy as np

from slipangle.control.speed.driver import DriverState, SpeedDriver
from slipangle.data.dataset import Dataset
from slipangle.data.signals import excitation as excite
from slipangle.errors import NotFiniteError, ParameterError, SampleTimeError, SimulationError
from slipangle.fields import Checked, Within
from slipangle.optimal.terms import Values, require_names
from slipangle.paths.path import Path
from slipangle.simulate.plant import Plant


@dataclass(frozen=True, kw_only=True, eq=False)
class Manoeuvre(Checked):
    """Steering angle [rad], positive to the left, and speed that the driver holds [m/s], shape (n,), for `record`.

    From ``release`` [s] on the driver's foot is off the throttle for good and the brake pedal at ``brake``.

    Raises ParameterError or NotFiniteError if lengths differ, a number is out of its range, or a value is not finite.
    """

    delta: np.ndarray
    v_x: np.ndarray
    dt: Annotated[float, Within(0, open="both", unit="s")] = 0.01
    release: float = math.inf
    brake: Annotated[float, Within(0, 1)] = 0.0
    name: str = "manoeuvre"

    def __post_init__(self) -> None:
        super().__post_init__()
        n = np.size(self.delta)
        for key in ("delta", "v_x"):
            values = np.array(np.broadcast_to(np.asarray(getattr(self, key), dtype=float), (n,)))
            if not np.isfinite(values).all():
                raise NotFiniteError(f"{key} of '{self.name}' is not finite everywhere; expected finite numbers")
            values.setflags(write=False)
            object.__setattr__(self, key, values)
        if n < 2:
            raise ParameterError(f"'{self.name}' has {n} samples; expected at least 2: make it longer")

    @property
    def t(self) -> np.ndarray:
        """Instants, shape (n,). [s]"""
        return excite.time(len(self.delta), self.dt)


def _samples(duration: float, dt: float) -> int:
    if not (duration > 0 and dt > 0):
        raise ParameterError(f"the duration is {duration} s, dt {dt} s; expected positive times")
    return round(duration / dt) + 1


def step_steer(
    v_x: float, amplitude: float, *, duration: float = 5.0, start: float = 1.0, rise: float = 0.1, dt: float = 0.01
) -> Manoeuvre:
    """Steering angle that rises to ``amplitude`` [rad] within ``rise`` and stays.

    Source: ISO 7401:2011, Road vehicles - Lateral transient response test methods.
    """
    n = _samples(duration, dt)
    delta = excite.step(n, dt, amplitude=amplitude, start=start, rise=rise)
    return Manoeuvre(delta=delta, v_x=np.full(n, v_x), dt=dt, name="step steer")


def sine_steer(
    v_x: float, amplitude: float, frequency: float, *, periods: float = 5.0, start: float = 1.0, dt: float = 0.01
) -> Manoeuvre:
    """Sine of the steering angle, to the left first: amplitude [rad], frequency [Hz].

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, sec. 7.1.3.
    """
    if not frequency > 0:
        raise ParameterError(f"the sine's frequency is {frequency} Hz; expected a positive number")
    n = _samples(start + periods / frequency, dt)
    t = excite.time(n, dt) - start
    delta = amplitude * np.sin(2 * np.pi * frequency * np.maximum(t, 0.0))
    return Manoeuvre(delta=delta, v_x=np.full(n, v_x), dt=dt, name="sine steer")


def sine_with_dwell(
    v_x: float, amplitude: float, *, duration: float = 6.0, frequency: float = 0.7, dt: float = 0.01
) -> Manoeuvre:
    """One sine that waits at its second peak, the foot off the throttle: FMVSS 126. Amplitude in rad at the wheels."""
    n = _samples(duration, dt)
    delta = excite.sine_with_dwell(n, dt, amplitude=amplitude, frequency=frequency, start=1.0)
    return Manoeuvre(delta=delta, v_x=np.full(n, v_x), dt=dt, release=1.0, name="sine with dwell")


def ramp_steer(
    v_x: float, rate: float, *, duration: float = 20.0, limit: float | None = None, dt: float = 0.01
) -> Manoeuvre:
    """Slowly increasing steer at constant speed, ``rate`` in rad/s: steady states up to the limit. ISO 4138."""
    n = _samples(duration, dt)
    delta = excite.ramp(n, dt, rate=rate, start=1.0, limit=limit)
    return Manoeuvre(delta=delta, v_x=np.full(n, v_x), dt=dt, name="ramp steer")


def steady_turn(
    v_x: float, delta: float, *, release: float = 5.0, brake: float = 0.0, duration: float = 9.0, dt: float = 0.01
) -> Manoeuvre:
    """A steady turn at ``delta`` [rad], left at ``release`` by lifting off (ISO 9816) or braking (ISO 7975)."""
    n = _samples(duration, dt)
    steered = excite.step(n, dt, amplitude=delta, start=0.5, rise=1.0)
    name = "braking in a turn" if brake else "throttle off in a turn"
    return Manoeuvre(delta=steered, v_x=np.full(n, v_x), dt=dt, release=release, brake=brake, name=name)


# ---- recording -----------------------------------------------------------------------------------------------------


def _ready(plant: Plant, manoeuvre: Manoeuvre, driver: SpeedDriver | None, fixed: Values) -> int:
    """How many steps of the plant one sample of the manoeuvre lasts; raises where it cannot be driven."""
    names = plant.model.inputs
    require_names(("delta",), names, "the manoeuvre", "use a plant that steers")
    require_names(fixed, names, "held", "use an input of the plant")
    shares = driver.inputs(0.0) if driver is not None else {}
    require_names(shares, names, "the driver", "share its output over inputs of the plant")
    missing = [n for n in names if n not in ("delta", "v_x", *shares, *fixed)]
    if missing:
        raise ParameterError(f"nobody sets the plant's inputs {missing}; expected a driver, or held= with their values")
    if manoeuvre.brake and "brake" not in names:
        raise ParameterError("the manoeuvre brakes, the plant has no input 'brake'; expected a plant with pedals")
    steps = round(manoeuvre.dt / plant.dt)
    if steps < 1 or not math.isclose(steps * plant.dt, manoeuvre.dt, rel_tol=1e-6):
        raise SampleTimeError(
            f"the manoeuvre's dt is {manoeuvre.dt:g} s, the plant's {plant.dt:g} s; expected a whole multiple"
        )
    return steps


def record(
    plant: Plant,
    manoeuvre: Manoeuvre,
    driver: SpeedDriver | None = None,
    *,
    channels: Sequence[str] = (),
    held: Values | None = None,
    x0: np.ndarray | None = None,
) -> Dataset:
    """Drive a manoeuvre without steering feedback and log it.

    Inputs of the record are the commands, each held until the next sample; outputs are ``channels`` as the sensors see
    them (by default the outputs of the plant's model), sampled when a command begins: NaN where a sensor lost a sample
    and shows it. The ``driver`` holds the wanted speed until the release; it is not needed where v_x is an input.
    ``held`` are constant inputs that nobody else sets, ``x0`` is where it starts, by default straight ahead at the
    first speed.

    Raises ParameterError if the plant lacks a channel or an input, or nobody sets one, SampleTimeError if the
    manoeuvre's sample time is no multiple of the plant's, and SimulationError if the plant leaves the finite numbers.
    """
    names, fixed = plant.model.inputs, held or Values()
    logged = tuple(channels) or tuple(n for n in plant.model.outputs if n not in names)
    require_names(logged, plant.channels, "channels", "log what the plant measures")
    steps = _ready(plant, manoeuvre, driver, fixed)
    shares = driver.inputs(0.0) if driver is not None else {}
    if driver is not None and not math.isclose(driver.dt, manoeuvre.dt):
        driver = replace(driver, dt=manoeuvre.dt)

    u = np.tile([fixed.get(n, 0.0) for n in names], (len(manoeuvre.delta), 1))
    u[:, names.index("delta")] = manoeuvre.delta
    if "v_x" in names:
        u[:, names.index("v_x")] = manoeuvre.v_x
    start = plant.straight(float(manoeuvre.v_x[0])) if x0 is None else np.asarray(x0, dtype=float)
    simulation = plant.start(start, u[0])
    rows, state = [], DriverState()
    slope = np.gradient(manoeuvre.v_x, manoeuvre.dt)
    for k, t in enumerate(manoeuvre.t):
        seen = simulation.measure()
        rows.append([seen[n] for n in logged])
        pedals: dict[str, float] = {}
        if t >= manoeuvre.release - 1e-9:
            pedals = {**dict.fromkeys(shares, 0.0), **({"brake": manoeuvre.brake} if manoeuvre.brake else {})}
        elif driver is not None:
            output, state = driver.step(state, float(manoeuvre.v_x[k]), seen["v_x"], float(slope[k]))
            pedals = driver.inputs(output)
        for name, value in pedals.items():
            u[k, names.index(name)] = value
        simulation.advance(u[k], steps)
        if not np.isfinite(simulation.x).all():
            raise SimulationError(
                f"the plant leaves the finite numbers at t = {t:g} s of '{manoeuvre.name}'; expected a stable "
                "plant: run it with a smaller step"
            )
    inputs, outputs = dict(zip(names, u.T, strict=True)), dict(zip(logged, np.array(rows).T, strict=True))
    return Dataset.from_arrays(inputs, outputs, manoeuvre.dt, name=manoeuvre.name)


# ---- paths ---------------------------------------------------------------------------------------------------------


def _ease(t: np.ndarray) -> np.ndarray:
    """0 to 1 with smooth slope and curvature."""
    t = np.clip(t, 0.0, 1.0)
    return t**3 * (10 - 15 * t + 6 * t**2)


def _waves(x: np.ndarray, start: float, stop: float, amplitude: float, length: float) -> np.ndarray:
    """Sine between two places that swells and fades within a wave."""
    inside = (x > start) & (x < stop)
    envelope = _ease((x - start) / length) * _ease((stop - x) / length)
    return np.where(inside, amplitude * envelope * np.sin(2 * np.pi * (x - start) / length), 0.0)


def slalom(
    v_x: float, *, spacing: float = 18.0, cones: int = 8, amplitude: float = 1.5, run: float = 30.0, lane: float = 0.0
) -> Path:
    """Path between cones in a row, to the left first; the waves swell and fade over the first and last two cones.

    The cones stand ``spacing`` apart, the path goes ``amplitude`` to their sides, ``run`` straight before and after;
    the lane is ``lane`` wide about the path, 0: unmarked. [m]
    """
    if not (spacing > 0 and cones >= 2 and amplitude > 0 and run > 0):
        raise ParameterError(
            f"spacing is {spacing} m, cones {cones}, amplitude {amplitude} m, run {run} m; expected positive lengths "
            "and at least 2 cones"
        )
    stop = run + spacing * (cones + 1)
    x = np.arange(0.0, stop + run + 0.25, 0.5)
    y = _waves(x, run, stop, amplitude, 2 * spacing)
    half = 0.5 * lane if lane else None
    return Path.from_points(x, y, right=half, left=half, name="slalom").with_speed(v_x)


def three_segments(
    *,
    speeds: tuple[float, float, float] = (11.0, 20.0, 15.0),
    amplitudes: tuple[float, float, float] = (5.0, 1.5, 1.5),
    lengths: tuple[float, float] = (120.0, 80.0),
    jump: float = 8.0,
    hold: float = 45.0,
) -> Path:
    """Path of wide slow waves, small fast waves, then abrupt jumps to the side.

    The source shows it in a figure without numbers, so the lengths here are our own. A jump of the reference is
    drawn over ``jump`` metres, which is faster than the car can follow.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, sec. 7.2.2.

    Parameters
    ----------
    speeds, amplitudes : tuple of float
        In each segment, blending over the straights between them [m/s]; of the waves and of the jumps [m].
    lengths : tuple of float
        Wave lengths of segments 1 and 2; two and a half, and three waves. [m]
    jump, hold : float
        Length of a jump and of the straight after it. [m]

    >>> path = three_segments()
    >>> bool(path.v_x.min() >= 10.0 and path.v_x.max() <= 20.0)
    True
    """
    if min(*speeds, *amplitudes, *lengths, jump, hold) <= 0:
        raise ParameterError("a speed or length of the three segments is not positive; expected positive numbers")
    gap = 60.0
    a = 30.0
    b = a + 2.5 * lengths[0]
    c = b + gap
    d = c + 3.0 * lengths[1]
    e = d + gap
    levels = amplitudes[2] * np.array([1.0, -1.0, 1.0, 0.0])
    end = e + len(levels) * (jump + hold)
    x = np.arange(0.0, end + 0.25, 0.5)
    y = _waves(x, a, b, amplitudes[0], lengths[0]) + _waves(x, c, d, amplitudes[1], lengths[1])
    last = 0.0
    for k, level in enumerate(levels):
        y += (level - last) * _ease((x - e - k * (jump + hold)) / jump)
        last = float(level)
    path = Path.from_points(x, y, name="three segments")
    along = path.X
    steps = (speeds[1] - speeds[0], b), (speeds[2] - speeds[1], d)
    v = speeds[0] + sum(rise * _ease((along - start) / gap) for rise, start in steps)
    return path.with_speed(v)


def lap(
    file: str | FilePath, *, v_max: float, a_y: float, a_x: float, a_brake: float | None = None, smoothing: float = 0.0
) -> Path:
    """A lap on a track file (`Path.from_csv`) with the fastest speed within acceleration limits. [m/s, m/s2]

    Raises MissingFileError, FormatError or ParameterError; see `Path.from_csv` and `Path.with_speed_limits`.
    """
    path = Path.from_csv(file, smoothing=smoothing)
    return path.with_speed_limits(v_max=v_max, a_y=a_y, a_x=a_x, a_brake=a_brake)
