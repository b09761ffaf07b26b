"""What is fuzzed: each target makes an input from random numbers, writes it to a file, and gives it to its reader."""

from __future__ import annotations

import io
import json
import struct
import tomllib
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat

from slipangle.errors import SlipangleError
from tests.fuzz.logs import make_expression, maker, read_expression, read_log
from tests.fuzz.mutate import CELLS, Rng, bytes_of, encoded, text_of, tree_of


@dataclass(frozen=True)
class Target:
    """Something that reads files.

    Parameters
    ----------
    make : callable
        From random numbers to a file's name and bytes, and options for ``read``.
    read : callable
        What must end in a result or in a `SlipangleError`.
    inputs : int
        How many are tried within some seconds, for the everyday tests.
    seconds : float
        Longest processor time of one input. [s]
    """

    make: Callable[[Rng], tuple[str, bytes, dict[str, Any]]]
    read: Callable[..., None]
    inputs: int
    seconds: float = 10.0


def _often(rng: Rng, share: float) -> bool:
    return bool(rng.random() < share)


def _pick(rng: Rng, options: tuple) -> Any:
    return options[int(rng.integers(len(options)))]


# ---- logs as text ------------------------------------------------------------------------------------------------

_HEADINGS = ("delta [deg]", "r", "v_x (km/h)", "yaw [deg/s]", "u", "y", "a_y [g]", "v_x", "brake [kPa]", "x", "Größe")


def _make_csv(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
    n, columns = int(rng.choice([1, 2, 3, 10, 60])), int(rng.integers(1, 5))
    names = [str(h) for h in rng.choice(_HEADINGS, columns, replace=_often(rng, 0.1))]
    step = float(_pick(rng, (0.01, 0.05, 1.0, 20.0, 2e7, 1e-9)))
    t = _pick(rng, (0.0, 1.7e9, -5.0)) + step * np.arange(n)
    if _often(rng, 0.2):
        t = t + step * rng.normal(size=n) * _pick(rng, (0.01, 0.3, 3.0))
    if _often(rng, 0.1):
        t[n // 2 :] += step * _pick(rng, (5.0, -5.0, 1e9, 0.5))
    table = rng.normal(size=(n, columns)) * _pick(rng, (1.0, 1e-200, 1e3, 1e300))
    separator = str(rng.choice([",", ";", "\t", " "]))
    form = str(rng.choice(["{:.6g}", "{:.17g}", "{:.0f}", "{:.3f}"]))
    rows = [separator.join(form.format(v) for v in (t[k], *table[k])) for k in range(n)]
    head = [separator.join((str(rng.choice(["t", "time [s]", "time [ms]", "stamp"])), *names))]
    text = "\n".join((head if _often(rng, 0.9) else []) + rows) + "\n"
    if separator == ";" and _often(rng, 0.5):
        text = text.replace(".", ",")
    if _often(rng, 0.1):
        text = '# slipangle: {"dt": 0.05, "inputs": ["u"], "notes": []}\n' + text
    raw = encoded(rng, text_of(rng, text) if _often(rng, 0.8) else text)
    options: dict[str, Any] = {}
    plain = [h.split(" ")[0] for h in names]
    for name, share, values in (
        ("nan", 0.5, ("gap", "error", "gap")),
        ("dt", 0.2, (0.01, 0.05, 1.0, -1.0, 0.0, float("nan"), 1e300)),
        ("time", 0.2, ("t", "stamp", "time", "no")),
        ("jitter", 0.2, (0.0, 0.5, 10.0, float("nan"))),
        ("shortest", 0.2, (0, 1, 2, 10**9)),
        ("skip_lines", 0.1, (0, 1, 10**9)),
        ("delimiter", 0.1, (",", ";", "\t", " ", "|")),
        ("experiment", 0.1, (plain[0], "no")),
        ("columns", 0.3, (plain, {"r": plain[0]}, {"r": plain[-1], "v_x": plain[0]}, ["no"])),
    ):
        if _often(rng, share):
            options[name] = _pick(rng, values)
    if _often(rng, 0.3):
        options |= {"inputs": plain[:1], "outputs": plain[-1:]}
    return "run.csv", bytes_of(rng, raw) if _often(rng, 0.2) else raw, options


def _read_csv(path: Path, **options: Any) -> None:
    from slipangle.data.quality.inspect import inspect
    from slipangle.data.readers import read_csv

    data = read_csv(path, **options)
    assert np.isfinite(data.values).all()
    assert data.n_samples <= 200
    if data.n_samples > 5:
        with np.errstate(all="ignore"):  # values of 1e300 may overflow
            inspect(data)


# ---- MATLAB ------------------------------------------------------------------------------------------------------


@cache
def _mat_bytes(kind: int) -> bytes:
    file = io.BytesIO()
    cells = np.empty((1, 2), dtype=object)
    cells[0, 0], cells[0, 1] = "SA", np.eye(3)
    content = (
        {"SA": np.linspace(0, 1, 30), "n": np.arange(6, dtype=np.int16).reshape(2, 3), "text": "hello"},
        {"channel": {"name": cells, "units": cells}, "c": cells, "x": np.zeros((0, 3))},
        {"z": np.array([1 + 2j]), "s": np.array(["ab", "cd"]), "b": np.array([True, False]), "f": np.float32(3.0)},
    )[kind]
    savemat(file, content)
    return file.getvalue()


def _squeezed(raw: bytes) -> bytes:
    """The same file with every variable compressed, damaged ones as they are."""
    out, at = raw[:128], 128
    while at + 8 <= len(raw):
        size = struct.unpack("<I", raw[at + 4 : at + 8])[0]
        packed = zlib.compress(raw[at : at + 8 + size])
        out += struct.pack("<II", 15, len(packed)) + packed
        at += 8 + size
    return out


def _make_mat5(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
    raw = bytes_of(rng, _mat_bytes(int(rng.integers(3))))
    return "run.mat", _squeezed(raw) if _often(rng, 0.3) else raw, {}


def _read_mat5(path: Path) -> None:
    from slipangle.data.readers.mat5 import read_mat5

    read_mat5(path)


# ---- tires -------------------------------------------------------------------------------------------------------


@cache
def _rig_file(suffix: str, kind: str, units: int) -> bytes:
    import tempfile

    from tests.rig import UNITS, channels, pounds, write_dat, write_mat

    columns = {k: v[::60] for k, v in channels(kind).items()}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"run.{suffix}"
        arguments = ((columns, UNITS), (columns, None), pounds(columns))[units]
        if suffix == "mat":
            write_mat(path, *(a for a in arguments if a is not None))
        else:
            write_dat(path, *arguments)
        return path.read_bytes()


def _make_ttc(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
    suffix = str(rng.choice(["mat", "dat", "dat"]))
    raw = _rig_file(suffix, str(rng.choice(["cornering", "drive/brake"])), int(rng.integers(3)))
    if suffix == "dat" and _often(rng, 0.8):
        return "run.dat", encoded(rng, text_of(rng, raw.decode())), {}
    return f"run.{suffix}", bytes_of(rng, raw), {}


def _read_ttc(path: Path) -> None:
    from slipangle.data.readers.ttc import read_ttc
    from slipangle.data.tire_data import levels

    run = read_ttc(path)
    assert np.isfinite(run.F_y).all()
    levels(run.load, 100.0)


@cache
def _tydex_text(kind: str) -> str:
    import tempfile

    from tests.rig import channels, write_tydex

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.tdx"
        write_tydex(path, {k: v[::60] for k, v in channels(kind, z_down=False).items()})
        return path.read_text(encoding="utf-8")


def _make_tydex(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
    text = _tydex_text(str(rng.choice(["cornering", "drive/brake"])))
    if _often(rng, 0.5):  # at the wheel's centre
        axes, height = str(rng.choice(["H", "C"])), _pick(rng, (250.0, -1.0, 1e300))
        for name in ("FYW", "FZW", "MXW", "MZW"):
            text = text.replace(f"{name} ", f"{name[:2]}{axes} ")
        more = "".join(
            f"{n:<10}{'':<30}{u:<10}{v:<10g}\n" for n, u, v in (("DSTGRWHC", "mm", height), (f"MY{axes}", "Nm", 7))
        )
        text = text.replace("**CONSTANTS\n", f"**CONSTANTS\n{more}")
    raw = encoded(rng, text_of(rng, text))
    return "run.tdx", bytes_of(rng, raw) if _often(rng, 0.2) else raw, {}


def _read_tydex(path: Path) -> None:
    from slipangle.data.readers.tydex import read_rig

    assert np.isfinite(read_rig(path).F_y).all()


@cache
def _tir_texts() -> tuple[str, ...]:
    from tests.data.readers.test_tir import TEXT
    from tests.models.tires.example_tires import TIRES

    return (TEXT, *(tire.to_tir().text for tire in TIRES.values()))


def _make_tir(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
    text = _pick(rng, _tir_texts())
    if _often(rng, 0.3):
        text += f"[SHAPE]\n{{radial width}}\n 1.0 0.0\n 0.9 {rng.choice(CELLS)}\n"
    raw = encoded(rng, text_of(rng, text))
    return "tire.tir", bytes_of(rng, raw) if _often(rng, 0.2) else raw, {}


def _read_tir(path: Path) -> None:
    from slipangle.data.readers.tir import read_tir
    from slipangle.errors import SlipangleError
    from slipangle.models.tires.magic_formula.tire import MagicFormulaTire

    file = read_tir(path)
    assert all(np.isfinite(v) for v in file.numbers.values())
    try:
        file.tables  # noqa: B018
        file.fit_type  # noqa: B018
    except SlipangleError:
        pass
    file.with_values({"MASS": 9.0}, section={"MASS": "DIMENSION"})
    tire = MagicFormulaTire.from_tir(file, force=True)
    tire.rolling(3000.0)
    with np.errstate(all="ignore"):  # coefficients of 1e308 may overflow
        tire.forces(np.array([0.0, 0.1]), np.array([0.05, -0.1]), np.array([3000.0, 4000.0]))
    tire.to_tir()


# ---- tracks ------------------------------------------------------------------------------------------------------


def _make_track(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
    n = int(rng.choice([3, 4, 5, 8, 40, 200]))
    angle = np.linspace(0, _pick(rng, (2 * np.pi, 5.0, 30.0, 0.0)), n)
    size = _pick(rng, (100.0, 100.0, 100.0, 1e-6, 1e5, 1e9, 1e300))
    table = [size * np.cos(angle), size * np.sin(angle)]
    if _often(rng, 0.3):
        table = [size * rng.normal(size=n), size * rng.normal(size=n)]
    if _often(rng, 0.6):
        table += [np.full(n, 5.0), np.full(n, _pick(rng, (5.0, -1.0, 0.0, 1e300)))]
    rows = [str(rng.choice([","])).join(f"{v:.9g}" for v in row) for row in zip(*table, strict=True)]
    text = "# x_m,y_m,w_right,w_left Nürburgring\n" + "\n".join(rows) + "\n"
    raw = encoded(rng, text_of(rng, text) if _often(rng, 0.7) else text)
    options = {
        "closed": _pick(rng, (None, None, True, False)),
        "smoothing": _pick(rng, (0.0, 0.0, 0.2, 5.0, 1e9, -1.0, float("nan"))),
        "spacing": _pick(rng, (0.25, 0.25, 1.0, 100.0, 1e-9, 0.0, float("nan"), float("inf"))),
    }
    return "track.csv", bytes_of(rng, raw) if _often(rng, 0.2) else raw, options


def _read_track(path: Path, **options: Any) -> None:
    from slipangle.paths.path import Path as Line

    track = Line.from_csv(path, **options)
    assert np.isfinite(track.curvature).all()
    if len(track.s) < 5000:
        track = track.with_speed_limits(v_max=30.0, a_y=8.0, a_x=4.0)
        assert np.isfinite(track.ahead(0.0, 20, 0.05).v_x).all()
        track.project(1.0, 2.0)


def _make_scenario(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
    from tests.paths.test_commonroad import lanelet

    pieces = [
        lanelet(k, 0.5 * k, 0.5 * k + 0.5, *rng.integers(0, 5, int(rng.integers(0, 3))), left=int(rng.integers(1, 9)))
        for k in range(int(rng.integers(0, 5)))
    ]
    raw = text_of(rng, f"<commonRoad>{''.join(pieces)}</commonRoad>").encode(errors="replace")
    options = {"lanelets": tuple(rng.integers(0, 5, int(rng.integers(0, 3))).tolist())}
    return "road.xml", bytes_of(rng, raw) if _often(rng, 0.2) else raw, options


def _read_scenario(path: Path, **options: Any) -> None:
    from slipangle.paths.path import Path as Line

    assert np.isfinite(Line.from_file(path, **options).curvature).all()


def _read_both_ways(path: Path, **options: Any) -> None:
    """A large table is read block by block, and gives what the same one read as a whole does, refusals too."""
    from slipangle.data.readers import read_csv, text_table

    def outcome() -> Any:
        try:
            data = read_csv(path, **options)
        except SlipangleError as error:
            return type(error), str(error)
        return data.values.tolist(), data.starts, data.start_times, data.dt, data.channels, data.notes

    whole, usual = outcome(), text_table._LARGE
    text_table._LARGE = 0
    try:
        blocks = outcome()
    finally:
        text_table._LARGE = usual
    assert blocks == whole
    if isinstance(whole[0], type):
        raise whole[0](whole[1])


# ---- jobs and models ---------------------------------------------------------------------------------------------


@cache
def _jobs() -> tuple[dict, ...]:
    from tests.workflow.test_cli import JOB

    folder = Path(__file__).parents[2] / "examples"
    texts = [JOB.format(more=""), *(p.read_text(encoding="utf-8") for p in sorted(folder.glob("*.toml")))]
    texts += [JOB.format(more="") + more for more in (_MODELS, _LOOP)]
    return tuple(tomllib.loads(text) for text in texts)


def toml_of(table: dict, prefix: str = "") -> str:
    """A nested table as TOML; what TOML cannot say is left out."""
    lines, later = [], []
    for key, value in table.items():
        name = json.dumps(key)
        if isinstance(value, dict):
            later.append(f"[{prefix}{name}]\n{toml_of(value, f'{prefix}{name}.')}")
        elif isinstance(value, list) and value and all(isinstance(v, dict) for v in value):
            later += [f"[[{prefix}{name}]]\n{toml_of(v, f'{prefix}{name}.')}" for v in value]
        elif value is not None:
            lines.append(f"{name} = {_inline(value)}")
    return "\n".join(lines + later) + "\n"


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {_inline(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_inline(v) for v in value if v is not None) + "]"
    if isinstance(value, float):
        return repr(value) if value == value and abs(value) != float("inf") else str(value)
    return json.dumps(value)


def _make_job(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
    if _often(rng, 0.05):
        depth = int(rng.choice([10, 1000, 20000]))
        return "job.toml", ("a=" + str(rng.choice(["[", "{a="])) * depth).encode(), {}
    text = toml_of(tree_of(rng, _pick(rng, _jobs())))
    raw = encoded(rng, text_of(rng, text)) if _often(rng, 0.3) else text.encode(errors="replace")
    return "job.toml", bytes_of(rng, raw) if _often(rng, 0.1) else raw, {}


def _read_job(path: Path) -> None:
    from slipangle.workflow.settings import read_settings

    read_settings(path)


_MODELS = """
[[model]]
name = "ekf"
kind = "relaxing-bicycle"
banked = true
rear_steered = true
torque_vectored = true
free = ["C_f", "steering_lag"]
fit = { kind = "ekf", noise_std = { r = 0.01 }, late = { r = 0.1 }, patience = 3 }
[[model]]
name = "hybrid"
kind = "hybrid"
base = "ekf"
discrepancy = { kind = "narx", hidden = [4, 3], stages = [{ horizon = 2, epochs = 3 }] }
[[model]]
name = "adapted"
kind = "adapt"
model = "hybrid"
train = ["log.csv"]
settings = { seconds = 3.5, inputs = ["delta"] }
[[model]]
name = "lure"
kind = "lure"
linear = { order = [1, 2], weights = "residual" }
[[model]]
name = "saved"
kind = "saved"
file = "model.json"
"""
_LOOP = """
[controller]
model = "bicycle"
kind = "mpc"
solver = { kind = "real-time", iterations = 2 }
Q = { Y = 1.0 }
slack = { Y = 3.0 }
[estimator]
kind = "ekf"
noise_std = { r = 0.01, X = 0.1 }
[plant]
friction = 0.7
noise = { r = 0.01 }
"""
_SMALL = """
[[model]]
name = "arx"
kind = "arx"
na = 1
nb = 2
[[model]]
name = "black box"
kind = "state-space"
order = 2
"""


def _make_run(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
    from tests.workflow.test_cli import JOB, log_rows

    job = tomllib.loads(JOB.format(more=_SMALL))
    if _often(rng, 0.9):
        job = tree_of(rng, job)
    log = "\n".join(",".join(row) for row in [["time", "steer", "speed", "yaw"], *log_rows(160)]) + "\n"
    if _often(rng, 0.3):
        log = text_of(rng, log)
    return "job.toml", toml_of(job).encode(errors="replace"), {"log": log}


def _run(path: Path, log: str) -> None:
    """The whole job, page included; what it cannot fit is said, not raised."""
    from slipangle.workflow.job import run_job
    from slipangle.workflow.page import build_page
    from slipangle.workflow.settings import read_settings

    (path.parent / "log.csv").write_bytes(log.encode(errors="replace"))
    settings = read_settings(path)
    if settings.data.file != ("log.csv",):
        return
    outcome = run_job(settings, lambda share, what: None)
    build_page(outcome, ["slipangle", "run", "job.toml"]).to_html()
    json.loads(outcome.to_json())


@cache
def _models() -> tuple[str, ...]:
    import tempfile

    from slipangle.models.storage import save
    from tests.models.all_models import ALL_MODELS

    texts = []
    with tempfile.TemporaryDirectory() as folder:
        for k, model in enumerate(ALL_MODELS.values()):
            texts.append(save(model, Path(folder) / f"{k}.json").read_text(encoding="utf-8"))
    return tuple(texts)


def _make_model(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
    text = _pick(rng, _models())
    if _often(rng, 0.2):
        return "model.json", bytes_of(rng, text.encode()), {}
    return "model.json", json.dumps(tree_of(rng, json.loads(text))).encode(errors="replace"), {}


def _read_model(path: Path) -> None:
    from slipangle.models.model import Model
    from slipangle.models.storage import load

    with np.errstate(all="ignore"):  # coefficients of 1e308 may overflow
        model = load(path)
        if isinstance(model, Model):
            x, u = np.full(model.n_states, 0.1), np.full(model.n_inputs, 0.1)
            model.output(model.step(x, u), u)


TARGETS: dict[str, Target] = {
    "csv": Target(_make_csv, _read_csv, 4000),
    "csv-blocks": Target(_make_csv, _read_both_ways, 1500),
    "mat5": Target(_make_mat5, _read_mat5, 5000),
    "ttc": Target(_make_ttc, _read_ttc, 2500),
    "tydex": Target(_make_tydex, _read_tydex, 1500),
    "tir": Target(_make_tir, _read_tir, 3000),
    "track": Target(_make_track, _read_track, 2500),
    "track-scenario": Target(_make_scenario, _read_scenario, 500),
    "job": Target(_make_job, _read_job, 3000),
    "run": Target(_make_run, _run, 40, seconds=60.0),
    "model": Target(_make_model, _read_model, 2500),
    "type-arrow": Target(maker("parquet", "feather", suffix=".parquet"), read_log, 150),
    "type-expression": Target(make_expression, read_expression, 1000),
    "type-ld": Target(maker("ld", suffix=".ld"), read_log, 400),
    "type-mat": Target(
        maker("mat5", "mat73", "mat5-labels", "mat73-labels", "timetables-v7", "timetables-v73", suffix=".mat"),
        read_log,
        300,
    ),
    "type-mdf": Target(maker("mdf3", "mdf4", suffix=".mf4"), read_log, 40),
    "type-position": Target(maker("gpx", "kml", suffix=".gpx", text=True), read_log, 500),
    "type-ros": Target(maker("bag", "db3", "mcap", suffix=".mcap"), read_log, 60),
    "type-text": Target(maker("motec", "racecapture", suffix=".csv", text=True), read_log, 300),
}
