"""Jobs of several files: training files, separate test files, parameters of their own, starts from first samples."""

import json
import re

import numpy as np
import pytest

from slipangle.cli import main
from slipangle.data.dataset import Dataset
from slipangle.models.vehicles.bicycle import Bicycle, BicycleParams
from slipangle.workflow.log import read_logs
from slipangle.workflow.settings import read_settings
from tests.workflow.test_cli import sentence

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
    assert any(re.search(r"'day1.*' stands at t = 25.95 to", note) for note in logs.data.notes)
    assert "unseen" in logs.test.name
    assert "day0" in logs.train.name
    one = read_logs(read_settings(job(drives, train='"day0.csv"', test="[]")))
    assert (one.train.n_samples, one.test.n_samples) == (350, 150)


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
