"""The first screen: what to doubt about a parameter, what to do next."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from slipangle.identify.judge.scores import Score
from slipangle.models.model import FitInfo, ProfileInfo
from slipangle.workflow.overview import doubts, next_step, scoreboard


def fit(names, values, share, rho=0.0, warnings=()):
    values = np.asarray(values, dtype=float)
    std = np.asarray(share) * np.where(values == 0, 1.0, np.abs(values)) / 1.959964
    correlation = np.where(np.eye(len(names), dtype=bool), 1.0, rho)
    info = {"noise_std": np.ones(1), "n_samples": 10, "units": ("rad",) * len(names), "warnings": warnings}
    return FitInfo(names=names, values=values, covariance=np.outer(std, std) * correlation, **info)


def words(info):
    return {r.cells[0]: (r.cells[4], r.tone) for r in doubts("m", info).rows}


def test_what_to_doubt_is_said_beside_each_parameter():
    info = fit(("C_f", "C_r", "mu_f"), (1.0, 2.0, 3.0), (0.1, 0.5, 2.0), warnings=("C_f moves with the delay",))
    assert words(info) == {
        "C_f": ("a warning names it", "fair"),
        "C_r": ("wide: ± 50 %", "fair"),
        "mu_f": ("these data do not determine it", "poor"),
    }
    assert words(fit(("C_f",), (1.0,), (0.05,)))["C_f"] == ("", "good")
    assert words(fit(("C_f", "C_r"), (1.0, 1.0), (0.1, 0.1), rho=0.97))["C_f"][0] == "hardly told apart from C_r (0.97)"
    assert words(fit(("C_ff",), (1.0,), (0.05,), warnings=("C_f is odd",)))["C_ff"] == ("", "good")


def test_what_may_well_be_zero_is_not_poor():
    row = doubts("m", fit(("steering_offset",), (1e-9,), (1e7,))).rows[0]
    assert row.cells[1] == "0"
    assert row.cells[3] == "deg"
    assert (row.cells[4], row.tone) == ("may be 0", "fair")


def test_an_interval_that_lies_to_one_side_is_told_by_its_ends():
    """A share of 1.00 between 0.86 and 1.00 is not said to be 0.93 to 1.07."""
    one = fit(("drive_rear", "C_f"), (1.0, 2.0), (0.05, 0.05))
    info = ProfileInfo(
        **{f.name: getattr(one, f.name) for f in fields(one)} | {"units": ("-", "N/rad")},
        limits=np.array([[0.86, 1.0], [1.9, 2.1]]),
    )
    cells = {row.cells[0]: row.cells[2] for row in doubts("m", info).rows}
    assert cells == {"drive_rear": "0.860 to 1.000", "C_f": "± 0.10"}
    assert repr(info) == "<ProfileInfo: drive_rear = 1 (0.86 to 1), C_f = 2 ± 0.1; 0 warnings>"


def outcome(word="good", info=None, **more):
    score = Score(fit=90.0, vaf=99.0, rmse=0.01, r2=0.98)
    stands = SimpleNamespace(
        word=word,
        highest=95.0,
        noise=0.005,
        best="line",
        baselines={"line": Score(fit=50.0, vaf=75.0, rmse=0.05, r2=0.7)},
    )
    model = SimpleNamespace(outputs=("r",), fit_info=info, told_by_poles=False)
    v = SimpleNamespace(
        name="car",
        model=model,
        free_run_scores={"r": score},
        standing={"r": stands},
        free_run=SimpleNamespace(astray={}),
    )
    data = SimpleNamespace(unit=lambda name: "rad/s")
    plain = {"failures": {}, "run": None, "tried": None, "settings": SimpleNamespace(controller=None)}
    rest = {"validations": (v,), "data": data, "test": SimpleNamespace(duration=30.0)}
    return SimpleNamespace(**{**plain, **rest, **more})


def test_models_stand_beside_what_noise_allows_in_degrees():
    table = scoreboard(outcome(info=fit(("C_f",), (1.0,), (0.05,))), "slipangle run job.toml")
    [row] = table.rows
    assert row.cells == ("car", "r", "good", 90.0, 95.0, 50.0, "0.573 deg/s", 1)
    assert row.tone == "good"
    assert [c.title for c in table.columns][:5] == ["model", "output", "verdict", "fit", "at most"]


def test_a_model_that_runs_away_is_poor():
    lost = outcome()
    lost.validations[0].free_run.astray["r"] = "it leaves"
    assert scoreboard(lost, "").rows[0].cells[2] == "poor"


def drive(seconds=0.001, inside=True, good=True, solver="ipopt", finished=True, marked=True):
    settings = SimpleNamespace(controller=SimpleNamespace(dt=0.05, entries={"solver": solver}))
    tried = SimpleNamespace(trials=SimpleNamespace(good=good))
    seen = {"inside": inside, "finished": finished, "marked": marked, "kept": inside and finished and marked}
    run = SimpleNamespace(warm_seconds=np.full(49, seconds), **seen)
    return {"run": run, "settings": settings, "tried": tried}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"failures": {"ARX": "why"}}, "see why ARX failed"),
        ({"word": "poor"}, "look at Data and Residuals"),
        ({"info": fit(("C_f",), (1.0,), (3.0,))}, "drive what determines C_f"),
        ({}, "control with car: add a [controller]"),
        (drive(seconds=0.08), 'solver = "realtime"; the solver takes 80 of 50 ms'),
        (drive(inside=False), "the car leaves its lanes"),
        (drive(inside=False, finished=False), "drive slower"),
        (drive(marked=False), "the car leaves its path"),
        (drive(finished=False), "look why the car does not come to the end"),
        (drive(good=False), "slipangle robust"),
        (drive(), "slipangle export c"),
    ],
)
def test_what_to_do_next_is_the_first_thing_that_stands_in_the_way(given, said):
    assert next_step(outcome(**given)).startswith("Next: ")
    assert said in next_step(outcome(**given))


def test_offsets_that_may_be_zero_do_not_stand_in_the_way():
    info = replace(fit(("C_f", "steering_offset"), (1.0, 1e-9), (0.05, 1e7)))
    assert "control with car" in next_step(outcome(info=info))
