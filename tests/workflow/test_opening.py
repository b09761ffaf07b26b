"""The opening of a test record: offsets of that day are read from it, and no score counts it."""

import json
from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from slipangle.cli import main
from slipangle.errors import ConfigError
from slipangle.models.storage import save
from slipangle.workflow.job import run_job
from slipangle.workflow.log import read_logs
from slipangle.workflow.page import build_page
from slipangle.workflow.settings import read_settings
from slipangle.workflow.verdict import verdicts

CAR = dict(mass=1500.0, inertia_z=2500.0, wheelbase=2.7, l_f=1.2, C_f=9e4, C_r=1.1e5)
OFFSETS, DT = (0.010, -0.008, 0.004), 0.05
JOB = """
title = "days"
[data]
file = ["day0.csv", "day1.csv"]
test = {test}
inputs = ["delta", "v_x"]
outputs = ["r"]
{more}
[[model]]
name = "bicycle"
kind = "bicycle"
car = {{ mass = 1500, inertia_z = 2500, wheelbase = 2.7, l_f = 1.2, C_f = 7e4, C_r = 9e4 }}
free = ["C_f", "C_r"]
per_experiment = ["steering_offset"]
[[model]]
name = "arx"
kind = "arx"
na = 2
nb = 2
"""


def day(k):
    """A minute of weaving, with the zero that the steering's sensor had, and the wheels turning by what is left."""
    rng = np.random.default_rng(k)
    delta = 0.02 * np.convolve(np.repeat(rng.standard_normal(120), 10), np.ones(8) / 8, "same") + OFFSETS[k]
    v_x = 18 + 6 * np.sin(0.01 * np.arange(1200) + k)
    drive = sa.Dataset.from_arrays({"delta": delta, "v_x": v_x}, {"r": np.zeros(1200)}, DT)
    r = sa.Bicycle(params=sa.BicycleParams(**CAR, steering_offset=OFFSETS[k]), dt=DT).simulate(drive).y[:, 0]
    return np.column_stack([DT * np.arange(1200), delta, v_x, r + 0.002 * rng.standard_normal(1200)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("days")
    for k in range(3):
        head = "t [s],delta [rad],v_x [m/s],r [rad/s]"
        np.savetxt(folder / f"day{k}.csv", day(k), delimiter=",", header=head, comments="")
    for name, more in (("plain", ""), ("opened", "opening = 15.0")):
        (folder / f"{name}.toml").write_text(JOB.format(test='"day2.csv"', more=more))
    return folder


@pytest.fixture(scope="module")
def outcomes(folder):
    return {name: run_job(read_settings(folder / f"{name}.toml")) for name in ("plain", "opened")}


def test_a_days_offset_is_read_and_the_rest_judged(outcomes):
    plain, opened = (outcomes[name].validations[0] for name in ("plain", "opened"))
    assert plain.model.value("steering_offset") == pytest.approx(np.mean(OFFSETS[:2]), abs=5e-4)
    assert opened.model.value("steering_offset") == pytest.approx(OFFSETS[2], abs=5e-4)
    assert opened.model.value("C_f") == plain.model.value("C_f")
    assert opened.free_run_scores["r"].fit > plain.free_run_scores["r"].fit + 5
    trained = outcomes["opened"].training[0].model  # the mean of the days that it was fitted to
    assert trained.value("steering_offset") == plain.model.value("steering_offset")


def test_what_was_read_counts_in_no_score_of_any_model(outcomes):
    plain, opened = outcomes["plain"], outcomes["opened"]
    assert opened.opening.n_samples == 300
    assert np.array_equal(opened.opening["r"], plain.test["r"][:300])
    assert np.array_equal(opened.test["r"], plain.test["r"][300:])
    for v in opened.validations:
        assert len(v.free_run.t) == 900
    assert np.array_equal(opened.validations[1].model.A, plain.validations[1].model.A)
    assert opened.metrics()["data"]["n_opening"] == 300
    assert "n_opening" not in plain.metrics()["data"]


def test_the_page_says_what_was_read_and_that_it_does_not_count(outcomes):
    said = outcomes["opened"].metrics()["corrections"]
    (read,) = said["bicycle"]
    assert read.startswith("read from the first 15 s of 'day2', which no score counts: steering_offset 0.00")
    assert said["arx"] == []
    text = build_page(outcomes["opened"], ["slipangle", "run", "opened.toml"]).to_html()
    assert "which no score counts: steering_offset" in text
    words = " ".join(v.sentence for v in verdicts(outcomes["opened"], ""))
    assert "Over 45 s that it was not fitted to, after an opening of 15 s, “bicycle” fits" in words
    assert "From the opening they read what is that day" in text


def test_saved_models_are_judged_the_same_way(outcomes, folder, capsys):
    fitted, opened = outcomes["opened"].training[0].model, outcomes["opened"].validations[0]
    save(fitted, folder / "bicycle.json")
    job = str(folder / "opened.toml")
    assert main(["validate", str(folder / "bicycle.json"), "--data", job, "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["free_run"]["r"]["fit"] == pytest.approx(opened.free_run_scores["r"].fit, abs=1e-9)
    assert numbers["opening"][0].startswith("bicycle: read from the first 15 s of 'day2'")
    assert main(["compare", str(folder / "bicycle.json"), "--data", job]) == 0
    words = capsys.readouterr().out
    assert "bicycle: read from the first 15 s" in words
    assert f"r: fit {opened.free_run_scores['r'].fit:.2f} %" in words


@pytest.mark.parametrize(
    ("test", "more", "said"),
    [
        ('"day2.csv"', "opening = 60.0", "opening is 60 s of a test record of"),
        ('["day2.csv", "day3.csv"]', "opening = 10.0", "an opening and 2 test files; expected one"),
        ('"day2.csv"', "opening = 0.0", "opening is 0"),
    ],
)
def test_an_opening_that_cannot_be_is_refused(folder, test, more, said):
    (folder / "wrong.toml").write_text(JOB.format(test=test, more=more))
    with pytest.raises(ConfigError, match=said):
        read_logs(read_settings(folder / "wrong.toml"))


def test_a_split_log_may_have_an_opening_too(folder):
    settings = read_settings(folder / "opened.toml")
    whole = read_logs(replace(settings, data=replace(settings.data, test=())))
    assert whole.opening is not None
    assert whole.opening.n_samples == 300
    assert whole.test.n_samples == 2400 - round(0.7 * 2400) - 300
