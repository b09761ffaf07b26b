"""What a page says in several places says the same: words and sentences, doubts and warnings, delays, drives."""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import slipangle as sa
from slipangle.simulate.run import End
from slipangle.workflow.job import run_job
from slipangle.workflow.overview import doubts, scoreboard
from slipangle.workflow.page import summary
from slipangle.workflow.settings import read_settings
from slipangle.workflow.verdict import verdicts

JOB = """
title = "a job"
out = "out"
[data]
file = "log.csv"
inputs = ["delta", "v_x"]
outputs = ["r"]
rate = 20

[[model]]
name = "car"
kind = "bicycle"
car = {{ mass = 1200, inertia_z = 1500, wheelbase = 2.6, l_f = 1.2, C_f = 6e4, C_r = 6e4 }}
free = ["C_f", "C_r", "inertia_z"]

[[model]]
name = "black box"
kind = "arx"
na = 2
nb = 2
{more}
"""
CONTROLLER = """
[controller]
model = "car"
v_x = 15.0
cars = 20
"""
# Steering late by so many samples, noise of the yaw rate [rad/s], how fast the steering moves, a drive or none
LOGS = {
    "clean": (0, 0.002, 1.0, CONTROLLER),
    "late": (3, 0.003, 1.0, ""),
    "noisy": (0, 0.3, 1.0, ""),
    "drowned": (0, 30.0, 1.0, ""),
    "slow": (0, 0.003, 0.05, ""),
}


@pytest.fixture(scope="module", params=LOGS)
def outcome(request, tmp_path_factory):
    late, noise, pace, more = LOGS[request.param]
    folder = tmp_path_factory.mktemp("log")
    rng = np.random.default_rng(3)
    n, dt = 2400, 0.05
    kernel = np.ones(max(8, round(8 / pace))) / max(8, round(8 / pace))
    delta = 0.05 * np.convolve(np.repeat(rng.standard_normal(n // 20), 20), kernel, "same")
    v_x = 15 + 4 * np.sin(0.01 * np.arange(n))
    params = sa.BicycleParams(mass=1200, inertia_z=1600, wheelbase=2.6, l_f=1.2, C_f=8e4, C_r=9e4)
    drive = sa.Dataset.from_arrays({"delta": delta, "v_x": v_x}, {"r": np.zeros(n)}, dt)
    r = sa.Bicycle(params=params, dt=dt, outputs=("r",)).simulate(drive).y[:, 0]
    r = np.concatenate([np.zeros(late), r[: n - late]]) + noise * rng.standard_normal(n)
    table = np.column_stack([dt * np.arange(n), delta, v_x, r])
    np.savetxt(folder / "log.csv", table, delimiter=",", header="t [s],delta [rad],v_x [m/s],r [rad/s]", comments="")
    Path(folder / "job.toml").write_text(JOB.format(more=more))
    return run_job(read_settings(folder / "job.toml"))


def test_the_table_and_the_sentences_give_one_verdict(outcome):
    tones = {v.title: v.tone for v in verdicts(outcome, "")}
    for row in scoreboard(outcome, "").rows:
        name, output, word = row.cells[:3]
        assert tones[f"{name}, the {'yaw rate' if output == 'r' else output}"] == word == row.tone


def test_no_parameter_is_called_sound_that_a_warning_names(outcome):
    for v in outcome.validations:
        info = v.model.fit_info
        if v.model.told_by_poles:
            continue
        named = {n for n in info.names if any(re.search(rf"(?<!\w){n}(?!\w)", s) for s in info.warnings)}
        unsound = {row.cells[0] for row in doubts(v.name, info).rows if row.tone != "good"}
        assert named <= unsound
        assert all(row.cells[4] for row in doubts(v.name, info).rows if row.tone != "good")


def test_no_pair_of_channels_has_a_delay_and_has_none(outcome):
    said = [*outcome.quality.sentences, *outcome.delay_check, *summary(outcome)]
    for a, b in itertools.permutations(("delta", "v_x", "r"), 2):
        none = any(f"no clear delay between {a} and {b}" in s for s in said)
        some = any(f"{b} follows {a} by" in s for s in said)
        assert not (none and some), (a, b)
    times = {s.split(" ms")[0] for s in said if s.startswith("r follows delta by")}
    assert len(times) <= 1


def test_a_drive_is_no_better_than_its_cars(outcome):
    if outcome.run is None:
        assert "Closed loop" not in {v.title for v in verdicts(outcome, "")}
        return
    [drive] = [v for v in verdicts(outcome, "") if v.title == "Closed loop"]
    order = ("poor", "fair", "good")
    assert order.index(drive.tone) <= order.index(outcome.tried.trials.word)
    assert ("leaves its lanes" in drive.sentence.split(".")[0]) == (not outcome.run.inside)


@pytest.mark.parametrize("end", [End.TIME, End.LEFT_PATH, End.NOT_FINITE])
def test_a_car_that_does_not_come_to_its_path_s_end_is_not_called_good(outcome, end):
    if outcome.run is None:
        return
    stood = replace(outcome, run=replace(outcome.run, end=end))
    [drive] = [v for v in verdicts(stood, "") if v.title == "Closed loop"]
    assert drive.tone == "poor"
    assert end.value in drive.sentence
    assert not stood.metrics()["closed_loop"]["finished"]


@pytest.mark.parametrize(("beside", "tones"), [(0.4, {"good", "fair"}), (9.0, {"poor"})])
def test_a_track_without_edges_is_named_and_judged_by_the_distance(outcome, beside, tones):
    if outcome.run is None:
        return
    bare = replace(outcome.run.path, left=None, right=None)
    run = replace(outcome.run, path=bare, e_y=np.full_like(outcome.run.e_y, beside))
    wanted = replace(outcome.settings.controller, track=Path("folder") / "line.csv")
    drawn = replace(outcome, run=run, settings=replace(outcome.settings, controller=wanted), tried=None)
    [drive] = [v for v in verdicts(drawn, "") if v.title == "Closed loop"]
    assert drive.tone in tones
    assert "the track “line.csv” at up to 54 km/h" in drive.sentence
    assert "ISO" not in drive.sentence
    assert "its lanes" not in drive.sentence
    assert f"{'keeps within' if beside < 0.5 else 'goes farther than'} 50 cm" in drive.sentence
    found = drawn.metrics()["closed_loop"]
    assert (found["inside_lane"], found["kept"]) == (None, beside < 0.5)
