"""Named public data sets as `Dataset`: `public("ferrari-250lm")`; licences and origins are in `registry`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import scipy
from scipy import io

from slipangle.data.clock import find_grid
from slipangle.data.dataset import Channel, Dataset, join
from slipangle.data.public.registry import fetch, list_sets
from slipangle.data.quality.events import despike, find_jumps
from slipangle.data.race import with_dead_reckoning
from slipangle.data.readers import Column, read_csv
from slipangle.data.readers.text_dialect import parse_heading
from slipangle.errors import FormatError, ParameterError, SampleTimeError, nearest


def public(name: str) -> Dataset:
    """Read a public data set, one of `LOADERS`, in SI units, at the rate it was recorded with.

    Inputs and outputs are chosen; `Dataset.notes` says what is odd about the data.

    Raises ParameterError if there is no such set, or it is not a log, and MissingFileError or HashError if its files
    cannot be had, or are not the published ones.
    """
    if name not in LOADERS:
        if any(s.name == name for s in list_sets()):
            raise ParameterError(
                f"the public data set '{name}' is not a log; expected one of {', '.join(LOADERS)}: get its files with "
                f"fetch('{name}')"
            )
        raise ParameterError(f"there is no public data set '{name}'; {nearest(name, LOADERS)}: use one of these names")
    return LOADERS[name]()


def _columns(**channels: str) -> dict[str, Column]:
    """Where channels are in a file, from headings with units such as ``"vicon x [m]"``."""
    headings = {name: parse_heading(text) for name, text in channels.items()}
    return {name: Column(heading.name, heading.unit) for name, heading in headings.items()}


def _on_grid(
    t: np.ndarray, values: np.ndarray, channels: Sequence[Channel], inputs: tuple[str, ...], output: str, name: str
) -> Dataset:
    """Recorded channels, stamped ``t`` [s], shape (n,) and (n, n_channels), as a data set."""
    grid = find_grid(t, what=name)
    table, starts = grid.onto(t, values)
    clock = {"dt": grid.dt, "starts": starts, "start_times": grid.start_times, "notes": grid.notes}
    return Dataset(values=table, channels=tuple(channels), inputs=inputs, outputs=(output,), name=name, **clock)


# ---- Ferrari 250 LM --------------------------------------------------------------------------------------------------

_FERRARI = _columns(delta="delta [rad]", v_x="vx [m/s]", r="yawRate [rad/s]", v_y="vy [m/s]", beta="beta_true [rad]")
_FERRARI |= _columns(a_x="axCG [m/s2]", a_y="ayCG [m/s2]", r_dot="yawAngAcc [rad/s2]")
_FERRARI |= _columns(delta_fl="deltaFL [rad]", delta_fr="deltaFR [rad]")


def _ferrari_run() -> Dataset:
    """The run of 22 February 2014 as recorded, 100 Hz, spikes and all."""
    files = {name: f"{column.source}.txt" for name, column in _FERRARI.items()}
    paths = fetch("ferrari-250lm", "t.txt", *files.values())
    t = np.loadtxt(paths["t.txt"])
    values = np.column_stack([np.loadtxt(paths[file]) for file in files.values()])
    channels = [Channel(name, column.unit or "-") for name, column in _FERRARI.items()]
    data = _on_grid(t, values, channels, ("delta", "v_x"), "r", "Ferrari 250 LM, Palm Beach")
    note = "delta is the road-wheel angle, beta = atan2(v_y, v_x); no pedals were recorded"
    return with_dead_reckoning(data.with_note(note))


def ferrari_250lm(rate: float = 20.0) -> Dataset:
    """The Ferrari run, ready for identification.

    The four single-sample spikes of ``delta`` are replaced by the median of five samples; then every
    channel passes a zero-phase low-pass at 0.4 of the new rate (8 Hz at 20 Hz) and is resampled. The
    spikes and the jumps of ``v_y`` are named in `Dataset.notes`. The yaw rate follows the steering by
    80 to 90 ms: nothing is shifted here.

    Inputs are ``delta`` [rad] and ``v_x`` [m/s], the output is ``r`` [rad/s]; ``v_y``, ``beta``, ``a_x``, ``a_y``,
    ``r_dot`` and the dead-reckoned ``X``, ``Y``, ``psi`` ride along.

    Raises SampleTimeError if the rate is not between 0 and 100 Hz, and MissingFileError or HashError if the files
    cannot be had, or are not the published ones.
    """
    if not 0 < rate <= 100:
        raise SampleTimeError(f"the rate is {rate} Hz; expected above 0 and at most 100 Hz, as recorded: lower it")
    data = _ferrari_run()
    jumps = find_jumps(data, "v_y")
    data, _ = despike(data, "delta")
    for channel in ("delta_fl", "delta_fr"):
        repaired, spikes = despike(data, channel)
        if spikes:
            said = f"{channel} had its spikes where delta has: {len(spikes)} replaced alike"
            data = replace(repaired, notes=(*data.notes, said))
    if jumps:
        where = ", ".join(f"{j.t:.2f}" for j in jumps)
        data = data.with_note(f"v_y jumps in one sample at t = {where} s: left as recorded")
    return data if rate == 1 / data.dt else data.resample(1 / rate, cutoff=0.4 * rate)


_STEERING_RATIO = 13.97  # handwheel over road wheel: see `_ferrari_session`


def _ferrari_session() -> Dataset:
    """Another session, 20 Hz, low-passed at 5 Hz by its publisher.

    Its parameter file says a steering ratio of 13.4. A sister file of the same publisher, telemetry_train_1.csv, is the
    run of `ferrari_250lm` itself: its handwheel angle over that run's road-wheel angle is 13.97, to 0.023 degrees.
    """
    paths = fetch("ferrari-250lm-session", "telemetry_train_0.csv", "params.csv")
    head, row = (line.split(",") for line in paths["params.csv"].read_text().strip().splitlines()[:2])
    published = float(dict(zip(head, row, strict=True))["steer_tau"])
    data = read_csv(
        paths["telemetry_train_0.csv"],
        {"delta": Column("handwheelAngle", "deg", factor=1 / _STEERING_RATIO)}
        | _columns(v_x="vxCG [m/s]", r="yawRate [deg/s]", delta_sw="handwheelAngle [deg]", psi="yawAngle [deg]")
        | _columns(a_x="axCG [m/s2]", a_y="ayCG [m/s2]"),
        time=Column("time", "s"),
        inputs=("delta", "v_x"),
        outputs=("r",),
        name="Ferrari 250 LM, another session",
    )
    return data.with_note(
        f"delta is the steering-wheel angle over {_STEERING_RATIO:g}, as a sister file of the same publisher has it, "
        f"which is the run ferrari-250lm; the published ratio is {published:g}"
    )


# ---- laboratory ------------------------------------------------------------------------------------------------------


def _robot_arm() -> Dataset:
    """DaISy 96-009: torque in, acceleration out, no units and no sample time."""
    data = read_csv(
        fetch("robot-arm")["robot_arm.dat"],
        {"u": Column(0, "-"), "y": Column(1, "-")},
        dt=1.0,
        inputs=("u",),
        outputs=("y",),
        name="flexible robot arm",
    )
    return data.with_note(
        "u is the reaction torque, y the arm's acceleration; neither unit nor sample time is known: 1 s"
    )


def _emps(name: str, file: str, title: str) -> Dataset:
    """Electro-mechanical positioning system: force in, position out, closed loop."""
    path = fetch(name, file)[file]
    try:
        mat = io.loadmat(path)
        t = mat["t"].ravel()
        columns = {
            "force": ("N", mat["vir"].ravel() * float(mat["gtau"].item())),
            "q": ("m", mat["qm"].ravel()),
            "q_ref": ("m", mat["qg"].ravel()),
            "voltage": ("V", mat["vir"].ravel()),
        }
        if "pulses_N" in mat:
            columns["force_pulses"] = ("N", mat["pulses_N"].ravel())
    except (KeyError, ValueError) as error:
        raise FormatError(
            f"'{path}' is not the record it should be ({error}); expected t, vir, gtau, qm, qg: fetch it again"
        ) from None
    channels = [Channel(n, unit) for n, (unit, _) in columns.items()]
    data = _on_grid(t, np.column_stack([v for _, v in columns.values()]), channels, ("force",), "q", title)
    return data.with_note("recorded in closed loop; the velocity was not measured")


# ---- autonomous cars -------------------------------------------------------------------------------------------------

_FULL_BRAKE = 1.8e6  # largest brake command of the log [Pa]


def _iac_putnam() -> Dataset:
    """Dallara AV-21 at Putnam Park, 25 Hz."""
    data = read_csv(
        fetch("iac-putnam", "Putnam_park2023_run4_2.csv")["Putnam_park2023_run4_2.csv"],
        _columns(delta="delta [rad]", throttle="throttle_ped_cmd [%]", brake="brake_ped_cmd [kPa]")
        | _columns(v_x="vx [m/s]", v_y="vy [m/s]", r="omega [rad/s]", a_x="ax [m/s2]")
        | _columns(X="x [m]", Y="y [m]", psi="phi [rad]", delta_rate="deltadelta [rad/s]")
        | _columns(**{f"v_{wheel}": f"wheel_{wheel} [km/h]" for wheel in ("fl", "fr", "rl", "rr")}),
        time=Column("time", "s"),
        name="Dallara AV-21, Putnam Park",
    )
    data = data.with_channel("psi", np.unwrap(data["psi"]), "rad")
    data = data.with_channel("pedal", data["throttle"] - data["brake"] / _FULL_BRAKE, "-")
    data = data.select(inputs=("pedal", "delta"), outputs=("v_x", "r"))
    return data.with_note("pedal = throttle - brake / 1.8 MPa, the largest command; the fast laps start at about 202 s")


_DART_RECORDS = ("car_1_Datarecording_09_04_2024_12_34_30.csv", "car_1_Datarecording_09_16_2024_10_02_28.csv")


def _dart_record(name: str) -> Dataset:
    """One drive of the small car: pose at 100 Hz, velocities from it."""
    data = read_csv(
        fetch("dart", name)[name],
        _columns(throttle="throttle [-]", steering="steering [-]", clock="elapsed time sensors [s]")
        | _columns(X="vicon x [m]", Y="vicon y [m]", psi="vicon yaw [rad]")
        | _columns(v_encoder="vel encoder [m/s]", r_imu="W (IMU) [rad/s]"),
        time=Column("vicon time", "s"),
        name="DART",
    )
    first = int(np.argmax(data["clock"] > 0))
    data = data.rows(first, data.n_samples).with_channel("psi", np.unwrap(data["psi"])[first:], "rad")
    said = [*data.notes, f"{first} rows before the sensors started were cut"]
    for channel in ("X", "Y", "psi"):
        data, spikes = despike(data, channel, threshold=6.0)
        if spikes:
            largest = max(spikes, key=lambda s: abs(s.size))
            said.append(
                f"{len(spikes)} spikes of {channel} (motion capture), up to {largest.read} at t = "
                f"{largest.t:.2f} s, replaced by the median of 5 samples"
            )
    window = 2 * round(0.075 / data.dt) + 1
    psi = data["psi"]
    east, north, r = (
        np.asarray(scipy.signal.savgol_filter(data[n], window, 2, deriv=1, delta=data.dt)) for n in ("X", "Y", "psi")
    )
    v_x = east * np.cos(psi) + north * np.sin(psi)
    v_y = -east * np.sin(psi) + north * np.cos(psi)
    said.append(f"v_x, v_y and r are derivatives of the pose over {window} samples (zero phase)")
    kept = ("throttle", "steering", "X", "Y", "psi", "v_encoder", "r_imu")
    channels = [Channel(n, data.unit(n)) for n in kept]
    channels += [Channel("v_x", "m/s"), Channel("v_y", "m/s"), Channel("r", "rad/s")]
    return Dataset(
        values=np.column_stack([*(data[n] for n in kept), v_x, v_y, r]),
        channels=tuple(channels),
        dt=data.dt,
        inputs=("throttle", "steering"),
        outputs=("v_x", "v_y", "r"),
        start_times=data.start_times,
        name=data.name,
        notes=tuple(said),
    )


def _dart() -> Dataset:
    """Both drives of the small car as two experiments."""
    return join(*(_dart_record(name) for name in _DART_RECORDS))


def _dart_steps() -> Dataset:
    """Eight throttle steps at 10 Hz, one experiment each."""
    parts = []
    for path in fetch("dart-steps").values():
        part = read_csv(
            path,
            _columns(throttle="throttle [-]", v_x="vel encoder [m/s]", steering="steering [-]")
            | _columns(a_x="acc x (IMU) [m/s2]", a_y="acc y (IMU) [m/s2]", r="W (IMU) [rad/s]"),
            time=Column("elapsed time sensors", "s"),
            dt=0.1,
            inputs=("throttle",),
            outputs=("v_x",),
            name="DART throttle steps",
        )
        parts.append(part)
    return join(*parts)


LOADERS: Mapping[str, Callable[[], Dataset]] = MappingProxyType(
    {
        "ferrari-250lm": _ferrari_run,
        "ferrari-250lm-session": _ferrari_session,
        "robot-arm": _robot_arm,
        "emps": lambda: _emps("emps", "DATA_EMPS.mat", "EMPS"),
        "emps-pulses": lambda: _emps("emps-pulses", "DATA_EMPS_PULSES.mat", "EMPS with force pulses"),
        "iac-putnam": _iac_putnam,
        "dart": _dart,
        "dart-steps": _dart_steps,
    }
)
"""The public logs and how each becomes a `Dataset`."""
