"""A saved model in the job of another session: the log that it was fitted to is read like the job's own."""

import json

import numpy as np
import pytest

import slipangle as sa
from slipangle.cli import main
from slipangle.workflow.job import identify_named
from slipangle.workflow.kinds import KINDS, Adapted
from slipangle.workflow.log import read_logs
from slipangle.workflow.settings import read_settings
from tests.identify.test_adapt import CAR, drifting, drive, with_noise
from tests.workflow.test_cli import sentence

JOB = """
title = "another session"
[data]
file = "session.csv"
inputs = ["delta", "v_x"]
outputs = ["r"]
train = 0.75
{data}
[data.columns]
delta = {{ column = "steer", unit = "deg" }}
v_x = {{ column = "speed", unit = "km/h" }}
r = {{ column = "yaw", unit = "deg/s" }}
[[model]]
name = "old"
kind = "saved"
file = "car.json"
[[model]]
name = "new"
kind = "adapt"
model = "old"
{more}
settings = {{ bias_prior = 0.2 }}
"""


def write_log(path, data, head=("time", "steer", "speed", "yaw")):
    columns = (data.t, np.degrees(data["delta"]), 3.6 * data["v_x"], np.degrees(data["r"]))
    rows = [",".join(f"{v:.9f}" for v in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([",".join(head), *rows]) + "\n")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Half a minute that scatters little around a steady error, of a model that errs five times as much elsewhere."""
    folder = tmp_path_factory.mktemp("sessions")
    (folder / "before").mkdir()
    seen = drifting(drive(3000, seed=40), 0, size=0.05)
    write_log(folder / "before" / "first.csv", seen.rows(0, 1400))
    write_log(folder / "before" / "second.csv", seen.rows(1400, 3000))
    write_log(folder / "headless.csv", seen, head=("time", "wheel", "speed", "yaw"))
    write_log(folder / "slow.csv", seen.resample(0.1))
    steady = with_noise(drive(1200, seed=41), 0.003)
    write_log(folder / "session.csv", steady.with_channel("r", steady["r"] + 0.02, "rad/s"))
    sa.save(CAR, folder / "car.json")
    return folder


def job(folder, more="", data=""):
    path = folder / "job.toml"
    path.write_text(JOB.format(more=more, data=data))
    return path


def python(settings, *files):
    """The same in Python, each file read by hand."""
    wanted = {"delta": sa.Column("steer", "deg"), "v_x": sa.Column("speed", "km/h"), "r": sa.Column("yaw", "deg/s")}

    def log(file):
        data = sa.read(settings.folder / file, wanted, inputs=["delta", "v_x"], outputs=["r"])
        return data if settings.data.rate is None else data.resample(1 / settings.data.rate)

    train = sa.join(*map(log, files)) if files else None
    return sa.Adapt(bias_prior=0.2).fit(CAR, log("session.csv").split(0.75)[0], train)


def adapted(path):
    settings = read_settings(path)
    return settings, identify_named(settings, "new", read_logs(settings))


@pytest.mark.filterwarnings("ignore:the model is left as it is:slipangle.errors.ModelWarning")
def test_a_job_with_training_data_gives_what_python_gives(folder, tmp_path, monkeypatch):
    """From any folder; as a list and as a pattern."""
    monkeypatch.chdir(tmp_path)
    for named in ("['before/first.csv', 'before/second.csv']", "'before/*.csv'"):
        settings, model = adapted(job(folder, f"train = {named}"))
        same = python(settings, "before/first.csv", "before/second.csv")
        assert (model.inputs_at_zero, model.gains, model.outputs_at_zero) == (
            same.inputs_at_zero,
            same.gains,
            same.outputs_at_zero,
        )
        assert model.fit_info.values == pytest.approx(same.fit_info.values, rel=1e-12)
        assert model.fit_info.warnings == same.fit_info.warnings
    assert "as over what it was fitted to" in model.fit_info.warnings[0]
    assert not any(model.outputs_at_zero.values())


def test_without_them_it_believes_more(folder):
    settings, model = adapted(job(folder))
    assert model.fit_info.warnings == ()
    assert model.outputs_at_zero == python(settings).outputs_at_zero
    assert model.outputs_at_zero["r"] > 0.01


@pytest.mark.filterwarnings("ignore:the model is left as it is:slipangle.errors.ModelWarning")
def test_they_are_resampled_like_the_log(folder):
    """A training log at another rate than the session's, both brought to that of the model."""
    settings, model = adapted(job(folder, "train = 'slow.csv'", data="rate = 20"))
    assert model.fit_info.values == pytest.approx(python(settings, "slow.csv").fit_info.values, rel=1e-9)
    assert "as over what it was fitted to" in model.fit_info.warnings[0]


def test_a_whole_run_tells_it(folder, tmp_path, capsys):
    path = job(folder, "train = 'before/*.csv'")
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert "as over what it was fitted to" in found["warnings"]["new"][0]
    assert found["models"]["new"]["free_run"] == found["models"]["old"]["free_run"]


@pytest.mark.parametrize(
    ("more", "data", "said"),
    [
        ("train = 'gone.csv'", "", "gone.csv"),
        ("train = 'gone*.csv'", "", "no file matches 'gone*.csv'"),
        ("train = 'slow.csv'", "", "train 'slow' is sampled every 0.1 s, the job's log every 0.05 s; expected one"),
        ("train = 'headless.csv'", "", "steer"),
        ("train = []", "", 'train is []; expected files such as ["log.csv"]'),
        ("train = ''", "", "train is ''; expected files such as"),
        ("train = 3", "", "train is 3; expected"),
        ("train = [3]", "", "train[0] is 3; expected text in quotes"),
        ("train = { file = 'x.csv' }", "", "train is {'file': 'x.csv'}; expected a list, each a file"),
        ("train = 'before/first.csv'", "beside = 'slow.csv'", "model 'new' those of another log as train; expected"),
    ],
)
def test_bad_training_data_are_told_in_a_sentence_before_any_fit(more, data, said, folder, tmp_path, capsys):
    assert main(["identify", str(job(folder, more, data)), "--out", str(tmp_path / "o")]) == 2
    assert said in sentence(capsys)


def test_another_kind_of_model_may_ask_for_a_log_too(folder, monkeypatch):
    """Whatever is registered with a setting that is a data set gets that of the files."""
    monkeypatch.setattr(KINDS, "_things", dict(KINDS))
    KINDS.register("like-adapt")(type("LikeAdapt", (Adapted,), {}))
    path = job(folder, "train = 'before/first.csv'")
    path.write_text(path.read_text().replace('kind = "adapt"', 'kind = "like-adapt"'))
    settings = read_settings(path)
    (files,) = read_logs(settings).others
    assert files == ("before/first.csv",)
    assert read_logs(settings).others[files].n_samples == 1400
