"""Jobs of several files: training files, separate test files, parameters of their own, starts from first samples."""

import json
import re

import numpy as np
import pytest

from slipangle.cli import main
from slipangle.data.dataset import Dataset
from slipangle.errors import ConfigError, ParameterError
from slipangle.models.vehicles.bicycle import Bicycle, BicycleParams
from slipangle.workflow import robustness
from slipangle.workflow.log import read_logs
from slipangle.workflow.settings import read_settings
from tests.workflow.test_cli import log_rows, sentence, write_job

TRUE = BicycleParams(mass=1200, wheelbase=2.6, l_f=1.2, inertia_z=1800, C_f=7e4, C_r=9e4)
OFFSETS = (0.01, -0.02, 0.004)  # rad, of the steering in each drive
JOB = """
title = "several drives"
[data]
file = {train}
test = {test}
inputs = ["delta", "v_x"]
outputs = ["r"]
{data}
[[model]]
name = "bicycle"
kind = "bicycle"
free = ["C_f", "C_r", "inertia_z"]
{model}
car = {{ mass = 1200, wheelbase = 2.6, l_f = 1.2, inertia_z = 1500, C_f = 8e4, C_r = 8e4 }}
"""


def drive(folder, name, offset, seed, n=500, dt=0.05):
    """A drive of the same car whose steering sensor reads too little by an offset."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * dt
    delta = 0.03 * np.sin((0.8 + 0.1 * seed) * t) + 0.02 * np.sin(2.9 * t + seed)
    v_x = 18 + 5 * np.sin(0.2 * t + seed)
    data = Dataset.from_arrays({"delta": delta + offset, "v_x": v_x}, {"r": np.zeros(n)}, dt)
    r = Bicycle(params=TRUE, dt=dt, outputs=("r",)).simulate(data).y[:, 0] + 0.001 * rng.standard_normal(n)
    rows = [f"{a:.3f},{b:.8f},{c:.6f},{d:.8f}" for a, b, c, d in zip(t, delta, v_x, r, strict=True)]
    (folder / name).write_text("\n".join(["time [s],delta [rad],v_x [m/s],r [rad/s]", *rows]) + "\n")


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    for k, offset in enumerate(OFFSETS):
        drive(folder, f"day{k}.csv", offset, k)
    drive(folder, "unseen.csv", float(np.mean(OFFSETS)), 7)
    return folder


def job(folder, *, train='["day0.csv", "day1.csv", "day2.csv"]', test='"unseen.csv"', data="", model=""):
    path = folder / "job.toml"
    path.write_text(JOB.format(train=train, test=test, data=data, model=model))
    return path


def test_files_are_experiments_one_after_another(drives):
    logs = read_logs(read_settings(job(drives)))
    assert logs.train.starts == (0, 500, 1000)
    assert logs.test.n_samples == 500
    assert logs.data.n_samples == logs.raw.n_samples == 2000
    assert np.all(np.diff(logs.data.t) > 0)
    assert any(re.search(r"'day1.*' is at t = 25.95 to", note) for note in logs.data.notes)
    assert "unseen" in logs.test.name
    assert "day0" in logs.train.name
    one = read_logs(read_settings(job(drives, train='"day0.csv"', test="[]")))
    assert (one.train.n_samples, one.test.n_samples) == (350, 150)


def test_files_of_a_clock_that_is_off_a_little_or_of_other_rates_are_put_on_one(tmp_path):
    drives = tmp_path
    drive(drives, "day0.csv", 0.0, 0)
    drive(drives, "unseen.csv", 0.0, 7)
    drive(drives, "off.csv", 0.0, 3, dt=0.0501)
    drive(drives, "slow.csv", 0.0, 3, dt=0.1)
    logs = read_logs(read_settings(job(drives, train='["day0.csv", "off.csv"]')))
    assert logs.raw.dt == 0.05
    assert logs.train.duration == pytest.approx(25 + 25.05, abs=0.2)
    with pytest.raises(ConfigError, match="give \\[data\\] a rate"):
        read_logs(read_settings(job(drives, train='["day0.csv", "slow.csv"]')))
    logs = read_logs(read_settings(job(drives, train='["day0.csv", "slow.csv"]', data="rate = 10")))
    assert logs.train.duration == pytest.approx(25 + 50, abs=0.3)


@pytest.mark.parametrize("rate", ["", "rate = 20"])
def test_a_low_pass_is_run_at_the_logs_own_rate_too(tmp_path, rate):
    """A gain of one half at the corner, where its amplitude is read off by least squares; a slow tone is kept."""
    t = 0.05 * np.arange(800)
    tones = {f: 2 * np.pi * f * t for f in (0.1, 2.0)}
    delta = 0.02 * sum(map(np.sin, tones.values()))
    rows = [f"{a:.2f},{b:.9f},20,0" for a, b in zip(t, delta, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["time [s],delta [rad],v_x [m/s],r [rad/s]", *rows]))
    path = job(tmp_path, train='"a.csv"', test="[]", data=f"cutoff = 2\n{rate}")
    data = read_logs(read_settings(path)).data
    assert data.dt == 0.05
    assert "a zero-phase low-pass at 2 Hz" in data.notes
    inside = slice(100, 700)
    parts = np.column_stack([f(x[inside]) for x in tones.values() for f in (np.sin, np.cos)])
    found = np.linalg.lstsq(parts, data["delta"][inside])[0] / 0.02
    np.testing.assert_allclose(found, [1, 0, 0.5, 0], atol=2e-3)
    raw = read_logs(read_settings(job(tmp_path, train='"a.csv"', test="[]"))).data
    np.testing.assert_allclose(raw["delta"], delta, atol=1e-9)


@pytest.mark.parametrize("rate", ["", "rate = 8", "rate = 15"])
@pytest.mark.parametrize("first", [200, 201, 203])
def test_rows_of_the_training_files_are_no_test_whatever_they_are_resampled_to(drives, tmp_path, rate, first):
    head, *rows = (drives / "day1.csv").read_text().splitlines()
    (tmp_path / "part.csv").write_text("\n".join([head, *rows[first:]]) + "\n")
    (tmp_path / "day1.csv").write_text((drives / "day1.csv").read_text())
    path = job(tmp_path, train='"day1.csv"', test='"part.csv"', data=rate)
    n = 500 - first
    with pytest.raises(ParameterError, match=rf"{n} of {n} rows of 'part' .* are rows of 'day1', too"):
        read_logs(read_settings(path))


def test_a_corner_that_the_log_cannot_have_is_refused(drives):
    with pytest.raises(
        ParameterError, match=r"corner is 400\.0 Hz; expected between 0 and half the sample rate, 10 Hz"
    ):
        read_logs(read_settings(job(drives, data="cutoff = 400")))


def test_a_few_samples_behind_a_gap_do_not_keep_a_model_from_being_judged(tmp_path, capsys):
    drives = tmp_path
    for k in range(3):
        drive(drives, f"day{k}.csv", 0.0, k)
    drive(drives, "unseen.csv", 0.0, 7)
    rows = (drives / "unseen.csv").read_text().splitlines()
    (drives / "tail.csv").write_text("\n".join([*rows[:400], *rows[450:453]]) + "\n")
    given = job(drives, test='"tail.csv"')
    logs = read_logs(read_settings(given))
    assert logs.test.n_samples == 399
    assert any("1 piece between gaps of less than 1 s left out, 3 samples" in note for note in logs.test.notes)
    assert main(["run", str(given), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["free_run"]["r"]["fit"] > 50


def test_a_parameter_of_each_file_is_found(drives, tmp_path, capsys):
    given = job(drives, model='per_experiment = ["steering_offset"]')
    assert main(["run", str(given), "--out", str(tmp_path / "own"), "--json"]) == 0
    own = json.loads(capsys.readouterr().out)
    assert (own["data"]["n_train"], own["data"]["n_test"]) == (1500, 500)
    found = own["models"]["bicycle"]["parameters"]
    for k, offset in enumerate(OFFSETS):
        told = found[f"steering_offset[{k}]"]
        assert told["low"] < -offset < told["high"]  # it is taken off the logged angle
        assert told["value"] == pytest.approx(-offset, abs=5e-4)
    assert found["C_f"]["value"] == pytest.approx(TRUE.C_f, rel=0.05)
    assert main(["run", str(job(drives)), "--out", str(tmp_path / "none"), "--json"]) == 0
    none = json.loads(capsys.readouterr().out)
    assert own["free_run"]["r"]["fit"] > none["free_run"]["r"]["fit"] + 1
    page = (tmp_path / "own" / "index.html").read_text()
    assert "day0, day1, day2" in page
    assert "other files" in page


def test_validate_and_identify_take_the_same_files(drives, tmp_path, capsys):
    given = str(job(drives, model='per_experiment = ["steering_offset"]'))
    assert main(["identify", given, "--out", str(tmp_path), "--json"]) == 0
    capsys.readouterr()
    assert main(["validate", str(tmp_path / "bicycle.json"), "--data", given, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["free_run"]["r"]["fit"] > 90


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"test": '"missing.csv"'}, "missing.csv"),
        ({"test": '"day1.csv"'}, r"'day1.csv' is named for training and for testing; expected"),
        ({"train": '["day0.csv", "day0.csv"]'}, r"'day0.csv' is named twice; expected"),
        ({"model": 'per_experiment = ["C_f"]'}, r"C_f is named twice in free and per_experiment"),
        ({"model": 'per_experiment = ["steering_ofset"]'}, "steering_ofset.*nearest are 'steering_offset'"),
        ({"data": 'set = "ferrari-250lm"'}, r"names both a file and a set"),
        ({"data": "start = 500"}, r"has 500 samples.*start.*500"),
    ],
)
def test_bad_files_get_a_sentence(drives, tmp_path, capsys, change, said):
    assert main(["run", str(job(drives, **change)), "--out", str(tmp_path / "out")]) == 2
    assert re.search(said, sentence(capsys))
    assert not (tmp_path / "out").exists()


def test_a_pattern_takes_files_but_those_for_testing(drives):
    logs = read_logs(read_settings(job(drives, train='"*.csv"', test='"unse*.csv"')))
    assert logs.train.starts == (0, 500, 1000)
    assert logs.test.n_samples == 500
    assert "unseen" in logs.test.name


@pytest.mark.parametrize(
    ("train", "test", "data", "said"),
    [
        ('"nothing*.csv"', "[]", "", "no file matches 'nothing*.csv'"),
        ('"*.csv"', '"*.csv"', "", "is named for training and for testing"),
        ('"day?.csv"', '"day*.csv"', "", "names no file that is not a test file"),
        ('["day0.csv", "day1.csv"]', "[]", 'beside = "day2.csv"', "expected one file, which those beside it"),
        ('"day0.csv"', "[]", "[data.columns]\nr = {unit = 'deg'}", "[data.columns]: a column has neither"),
        ('"day0.csv"', "[]", "[data.columns]\nr = {column = 'r', sign = 2}", "sign is 2"),
        ('"day0.csv"', "[]", "[data.columns]\nr = {column = 'r', ratio = 0}", "ratio of a column is 0"),
    ],
)
def test_files_that_cannot_be_are_said(drives, capsys, train, test, data, said):
    path = drives / "wrong.toml"
    parts = {"train": train, "test": test, "model": ""}
    path.write_text(
        JOB.format(**parts, data=data if "[data." not in data else "")
        if "[data." not in data
        else JOB.format(**parts, data="").replace("[[model]]", f"{data}\n[[model]]")
    )
    assert main(["identify", str(path), "--out", str(drives / "out")]) == 2
    assert said in sentence(capsys)


def test_a_job_scales_turns_derives_filters_and_merges(drives, tmp_path):
    """Raw counts of a hand wheel, curvature instead of a yaw rate, speed in a file of its own: the same drive."""
    whole = read_logs(read_settings(job(drives, train='"day0.csv"', test="[]"))).data
    counts = np.round(-whole["delta"] * 15 / np.radians(0.01) + 4000)
    rows = zip(whole.t, counts, whole["r"] / whole["v_x"], strict=True)
    text = "stamp,wheel,curvature\n" + "\n".join(f"{1e9 * t:.0f},{w:.0f},{c:.9g}" for t, w, c in rows)
    (tmp_path / "fast.csv").write_text(text)
    slow = "\n".join(f"{1e9 * t:.0f},{3.6 * v:.7f}" for t, v in zip(whole.t[::2], whole["v_x"][::2], strict=True))
    (tmp_path / "slow.csv").write_text(f"stamp,speed\n{slow}\n")
    columns = """filter = "t > 2 and v_x > 14"
[data.columns]
delta = { column = "wheel", unit = "deg", scale = 0.01, offset = -40, sign = -1, ratio = 15 }
v_x = { column = "speed", unit = "km/h" }
r = { derive = "curvature * v_x" }
[data.time]
column = "stamp"
unit = "ns"
"""
    path = job(tmp_path, train='"fast.csv"\nbeside = "slow.csv"', test="[]", data=columns)
    data = read_logs(read_settings(path)).raw
    kept = (whole.t > 2) & (whole["v_x"] > 14) & (whole.t <= whole.t[::2][-1])
    assert abs(data.n_samples - kept.sum()) <= 2
    rows = np.searchsorted(whole.t, data.t - 1e-6)
    np.testing.assert_allclose(data["delta"], whole["delta"][rows], atol=2e-5)
    np.testing.assert_allclose(data["v_x"], whole["v_x"][rows], atol=1e-3)
    np.testing.assert_allclose(data["r"], whole["r"][rows], atol=1e-4)


def test_a_job_without_outputs_is_told_so(drives, capsys):
    path = job(drives)
    text = path.read_text()
    assert "outputs = " in text
    path.write_text(re.sub(r"^outputs = .*$", "", text, flags=re.M))
    assert main(["identify", str(path)]) == 2
    assert "names outputs; expected the channels to be explained: add such as outputs" in sentence(capsys)


def test_the_journal_of_many_cars_is_of_what_the_files_hold(tmp_path):
    """A log under the same name may be of another drive, and a tire file another tire, while the job reads the same."""
    more = '[controller]\nmodel = "bicycle"\n[plant]\ntire = "tire.tir"'
    (tmp_path / "tire.tir").write_text("one")
    job = write_job(tmp_path, more=more)

    def signature(seed=0):
        settings = read_settings(job)
        return robustness.signature_of(job, settings, read_logs(settings), seed)

    signatures = [signature(), signature(1)]
    assert signature() == signatures[0]
    (tmp_path / "tire.tir").write_text("two")
    signatures.append(signature())
    write_job(tmp_path, rows=log_rows(450), more=more)
    signatures.append(signature())
    assert len(set(signatures)) == 4


@pytest.mark.parametrize(
    "how",
    ["", "rate = 8.0", "rate = 10.0", "cutoff = 3.0", "rate = 10.0\ndespike = ['r']", "rate = 50.0", "hold = 'mean'"],
)
@pytest.mark.parametrize("gap", [False, True])
def test_nothing_of_the_test_part_is_in_the_training_part(how, gap, tmp_path):
    """Not through a low-pass that runs both ways either: whatever is logged later, what is trained on stays."""
    rng = np.random.default_rng(0)
    t = 0.05 * np.arange(1000) + 30.0 * (gap & (np.arange(1000) >= 400))
    first = np.column_stack([t, 0.02 * np.sin(t), 20 + np.sin(0.1 * t), 0.1 * np.sin(t - 0.1)])
    other = first + 0.1 * (t >= 35.0 + 30.0 * gap)[:, None] * rng.standard_normal(first.shape) * [0, 1, 1, 1]
    parts = []
    for rows in (first, other):
        np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,delta,v_x,r", comments="", fmt="%.12g")
        text = JOB.format(train='["log.csv"]', test="[]", data=how, model="")
        (tmp_path / "job.toml").write_text(text)
        parts.append(read_logs(read_settings(tmp_path / "job.toml")))
    one, two = parts
    assert np.array_equal(one.train.values, two.train.values)
    assert not np.array_equal(one.test.values, two.test.values)
    assert one.train.n_samples == pytest.approx(0.7 * one.data.n_samples, abs=3)
    assert one.train.t[-1] < one.test.t[0] <= one.train.t[-1] + 4 * one.train.dt
    inner = one.train.n_samples - 40
    assert np.allclose(one.train.values[:inner, :3], one.data.values[:inner, :3], atol=1e-4)
