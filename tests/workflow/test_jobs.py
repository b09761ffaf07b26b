"""Jobs written by hand: bad entries are refused in a sentence at once, one bad model costs the others nothing."""

import json
import os
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from slipangle.cli import main
from slipangle.errors import ConfigError, UnitError
from slipangle.identify.networks.narx import NARX as NARXEstimator
from slipangle.models.vehicles.nonlinear_bicycle import with_speed_derivative
from slipangle.workflow.kinds import KINDS
from slipangle.workflow.log import read_logs
from slipangle.workflow.settings import read_settings
from tests.workflow.test_cli import JOB, log_rows, sentence, write_job

NARX = "[[model]]\nname = 'n'\nkind = 'narx'\n"
ARX = "[[model]]\nname = 'a'\nkind = 'arx'\n"
MPC = "[controller]\nmodel = 'bicycle'\n"

REFUSED = {  # what is written instead of what, or after the models; what is said
    "rate 0": (("rate = 20.0", "rate = 0.0"), r"\[data\]|data: rate is 0\.0 Hz; expected 0\.0001 to 100000 Hz"),
    "rate 1e-9": (("rate = 20.0", "rate = 1e-9"), r"rate is 1e-09 Hz; expected"),
    "rate 1e9": (("rate = 20.0", "rate = 1e9"), r"rate is 1000000000\.0 Hz; expected"),
    "rate of 400 digits": (("rate = 20.0", "rate = 1" + 400 * "0"), r"expected a number of at most"),
    "rate that is no number": (("rate = 20.0", "rate = nan"), r"rate is nan; expected a finite number"),
    "rate too low for the record": (("rate = 20.0", "rate = 0.01"), r"rate is 0\.01 Hz for a record of 20 s"),
    "train 0": (("rate = 20.0", "train = 0"), r"train is 0; expected 0\.01 to 0\.99|train is 0\.0; expected"),
    "hidden": (NARX + "hidden = [100000000]", r"hidden\[0\] is 100000000; expected 1 to 1e\+06"),
    "many weights": (NARX + "hidden = [1000, 1000, 1000]", r"'n' has about 2e\+06 weights; expected at most 1e\+06"),
    "many layers": (NARX + f"hidden = {[2] * 100}", r"hidden has 100 entries; expected at most 64"),
    "seeds": (NARX + "seeds = [-1]", r"seeds\[0\] is -1; expected 0 to"),
    "nb": (ARX + "nb = 1000000000", r"nb is 1000000000; expected 1 to 1e\+06"),
    "order": ("[[model]]\nname = 's'\nkind = 'state-space'\norder = 5000", r"order is 5000; expected 1 to 200"),
    "horizon": (MPC + "horizon = 1000000", r"horizon is 1000000 steps; expected 1 to 200 steps"),
    "speed": (MPC + "v_x = 0.0", r"v_x is 0\.0 m/s; expected 1 to 150 m/s"),
    "backward": (MPC + "v_x = -20", r"v_x is -20\.0 m/s; expected"),
    "weight": (MPC + "Q = { Y = -1.0 }", r"Q\.Y is -1\.0; expected 0 to"),
    "infinite": (MPC + "dt = inf", r"dt is inf; expected"),
    "centre of gravity": (("l_f = 1.2", "l_f = 9"), r"l_f is 9 m and the wheelbase 2\.6 m; expected"),
    "mass": (("mass = 1200, ", ""), r"car lacks mass; expected"),
    "out above": (('title = "test job"', 'title = "t"\nout = "../.."'), r"out is '../\.\.'; expected a folder below"),
    "out above, hidden": (('title = "test job"', 'title = "t"\nout = "a/../../b"'), r"expected a folder below.*--out"),
    "out absolute": (('title = "test job"', 'title = "t"\nout = "/tmp/x"'), r"expected a folder below"),
    "out on a drive": (('title = "test job"', "title = 't'\nout = 'C:\\\\x'"), r"expected a folder below"),
    "long key": (ARX + 100_000 * "x" + " = 1", r"no entry 'xxx"),
    "long word": (f"[[model]]\nname = 'a'\nkind = '{100_000 * 'x'}'", r"kind is 'xxx"),
    "long name twice": (2 * f"[[model]]\nname = '{100_000 * 'x'}'\nkind = 'arx'\n", r"names repeat: 'xxx"),
    "long controller": (f"[controller]\nmodel = '{100_000 * 'x'}'", r"uses the model 'xxx"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_bad_entries_are_refused_at_once(case, tmp_path, capsys):
    change, expected = REFUSED[case]
    job, more = (JOB, change) if isinstance(change, str) else (JOB.replace(*change), "")
    assert job != JOB or more
    assert main(["run", str(write_job(tmp_path, more=more, job=job)), "--out", str(tmp_path / "out")]) == 2
    said = sentence(capsys)
    assert re.search(expected, said), said
    assert len(said) < 500
    assert not (tmp_path / "out").exists()


def test_a_rate_that_no_memory_holds_is_refused(tmp_path, capsys):
    rows = [[f"{30 * k:.1f}", *row[1:]] for k, row in enumerate(log_rows())]
    job = JOB.replace("rate = 20.0", 'rate = 1e5\ntime = {{ column = "time", unit = "s" }}')
    assert main(["run", str(write_job(tmp_path, rows=rows, job=job)), "--out", str(tmp_path / "out")]) == 2
    assert re.search(r"rate is 100000 Hz for a record of .* channels; expected .* it was logged at", sentence(capsys))


def test_one_number_may_stand_without_brackets(tmp_path):
    more = "[[model]]\nname = 's'\nkind = 'state-space'\norder = 2\n[[model]]\nname = 'n'\nkind = 'narx'\nseeds = 3"
    _, states, network = read_settings(write_job(tmp_path, more=more)).model
    assert states.entries == {"order": 2}
    assert network.entries == {"seeds": (3,)}
    with pytest.raises(ConfigError, match="order is True; expected a whole number"):
        read_settings(write_job(tmp_path, more=more.replace("order = 2", "order = true")))


def test_the_folder_of_the_results_may_be_anywhere_from_the_command_line(tmp_path, capsys, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    job = write_job(tmp_path / "here", job=JOB.replace('title = "test job"', 'title = "t"\nout = "deep/../x"'))
    assert main(["run", "job.toml"]) == 0
    assert sorted(os.listdir("x")) == ["index.html", "metrics.json"]
    assert main(["run", str(job), "--out", "../elsewhere"]) == 0
    assert (tmp_path / "elsewhere" / "index.html").exists()
    capsys.readouterr()


def noisy(n=300):
    """A log of a second-order system, so that every black box fits."""
    rng = np.random.default_rng(0)
    steer, yaw = rng.standard_normal(n), np.zeros(n)
    for k in range(2, n):
        yaw[k] = 1.4 * yaw[k - 1] - 0.6 * yaw[k - 2] + 0.8 * steer[k - 1] + 0.05 * rng.standard_normal()
    return [[f"{v:.4f}" for v in (0.05 * k, steer[k], 80 + np.sin(0.2 * k), yaw[k])] for k in range(n)]


BROKEN = "[[model]]\nname = 'too long'\nkind = 'arx'\nna = 900\nnb = 900\n"


def test_a_model_that_fails_costs_the_others_nothing(tmp_path, capsys):
    job = write_job(tmp_path, rows=noisy(), more=BROKEN + ARX + "inputs = ['delta']")
    assert main(["run", str(job), "--out", str(tmp_path / "out"), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert sorted(found["models"]) == ["a", "bicycle"]
    assert re.search(r"samples for 2700 parameters.*expected", found["failures"]["too long"])
    assert "What could not be done" in (tmp_path / "out" / "index.html").read_text()
    assert main(["run", str(job), "--out", str(tmp_path / "out")]) == 1
    assert "too long: failed. " in capsys.readouterr().out
    assert main(["identify", str(job), "--out", str(tmp_path / "models"), "--json"]) == 1
    listed = json.loads(capsys.readouterr().out)
    assert sorted(listed) == ["a", "bicycle", "too long"]
    assert "failure" in listed["too long"]
    assert sorted(os.listdir(tmp_path / "models")) == ["a.json", "bicycle.json"]


def test_a_controller_whose_model_failed_is_left_out(tmp_path, capsys):
    more = BROKEN + "[controller]\nmodel = 'too long'\n[plant]\ncatalogue = 'sousa-table-6.1'"
    job = write_job(tmp_path, rows=noisy(), more=more)
    assert main(["run", str(job), "--out", str(tmp_path / "out"), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["failures"]["controller"] == "its model 'too long' could not be fitted"
    assert "closed_loop" not in found


def test_a_job_of_failures_ends_in_a_sentence(tmp_path, capsys):
    head, _, _ = JOB.partition("[[model]]")
    job = head + BROKEN.replace("{", "{{") + BROKEN.replace("too long", "again") + "{more}"
    assert main(["run", str(write_job(tmp_path, rows=noisy(), job=job)), "--out", str(tmp_path / "out")]) == 2
    assert "parameters" in sentence(capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["run", "identify"])
def test_where_all_fail_the_cause_is_said_and_not_what_follows_from_it(command, tmp_path, capsys):
    head, _, _ = JOB.partition("[[model]]")
    more = "[[model]]\nname = 'old'\nkind = 'saved'\nfile = 'gone.json'\n"
    more += "[[model]]\nname = 'today'\nkind = 'adapt'\nmodel = 'old'\n"
    job = write_job(tmp_path, more=more, job=head + "{more}")
    assert main([command, str(job), "--out", str(tmp_path / "out")]) == 2
    assert "gone.json' cannot be read" in sentence(capsys)


@pytest.mark.parametrize("command", ["run", "identify"])
def test_a_missing_extra_and_a_breakdown_cost_the_others_nothing(command, tmp_path, capsys, monkeypatch):
    """A network without JAX, and an estimator whose equations turn out singular."""

    class Singular:
        def fit(self, data):
            return np.linalg.solve(np.zeros((2, 2)), np.ones(2))

    monkeypatch.setattr(KINDS, "_things", dict(KINDS))
    KINDS.register("singular")(Singular)
    monkeypatch.setitem(sys.modules, "jax", None)
    more = NARX + "inputs = ['delta']\n[[model]]\nname = 's'\nkind = 'singular'\n"
    job = write_job(tmp_path, rows=noisy(), more=more)
    assert main([command, str(job), "--out", str(tmp_path / "out"), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    failed = found["failures"] if command == "run" else {n: f.get("failure", "") for n, f in found.items()}
    assert "needs jax, which is not installed" in failed["n"]
    assert "broke down in numbers (Singular matrix)" in failed["s"]
    assert "bicycle" in (found["models"] if command == "run" else found)
    alone = JOB[: JOB.index("[[model]]")] + "[[model]]\nname = 's'\nkind = 'singular'\n{more}"
    assert main([command, str(write_job(tmp_path, rows=noisy(), job=alone)), "--out", str(tmp_path / "out")]) == 2
    assert re.search(r"'s': its fit broke down in numbers .*; expected", capsys.readouterr().err)


def test_a_state_space_by_job_needs_no_settings(tmp_path, capsys):
    """On two inputs of which one hardly moves, and on a log without noise."""
    more = "[[model]]\nname = 's'\nkind = 'state-space'\n"
    for rows in (noisy(260), log_rows()):
        job = write_job(tmp_path, rows=rows, more=more + "inputs = ['delta']")
        code = main(["run", str(job), "--out", str(tmp_path / "out"), "--json"])
        found = json.loads(capsys.readouterr().out)
        if code == 0:
            assert found["models"]["s"]["free_run"]["r"]["fit"] > 90
        else:  # two sines excite four lags only
            assert "record richer excitation" in found["failures"]["s"]


def test_black_boxes_by_job_need_no_orders(tmp_path, capsys):
    """Each says what it compared, on the page too."""
    kinds = {"a": "arx", "m": "multi-arx", "s": "state-space"}
    more = "".join(f"[[model]]\nname = '{name}'\nkind = '{kind}'\n" for name, kind in kinds.items())
    more = more.replace("'arx'\n", "'arx'\ninputs = ['delta']\n").replace("space'\n", "space'\ninputs = ['delta']\n")
    job = write_job(tmp_path, rows=noisy(300), more=more)
    assert main(["run", str(job), "--out", str(tmp_path / "out"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert not found.get("failures")
    page = (tmp_path / "out" / "index.html").read_text()
    for name in kinds:
        assert found["models"][name]["free_run"]["r"]["fit"] > 80
        assert f"Orders compared for {name}" in page
    assert "Orders compared for bicycle" not in page
    assert KINDS["narx"] is NARXEstimator


@pytest.mark.slow
def test_a_network_by_job_needs_no_orders(tmp_path, capsys):
    more = "[[model]]\nname = 'n'\nkind = 'narx'\nhidden = [6]\n"
    job = write_job(tmp_path, rows=noisy(300), more=more + "inputs = ['delta']")
    assert main(["run", str(job), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert not json.loads(capsys.readouterr().out).get("failures")
    assert "Orders compared for n" in (tmp_path / "out" / "index.html").read_text()


@pytest.mark.parametrize(("unit", "scale"), [("ns", 1e9), ("ms", 1e3), ("us", 1e6)])
def test_stamps_in_other_units(unit, scale, tmp_path, capsys):
    rows = [[f"{scale * float(row[0]):.0f}", *row[1:]] for row in noisy()]
    stamped = JOB.replace("[data.columns]", f'time = {{{{ column = "time", unit = "{unit}" }}}}\n[data.columns]')
    assert main(["run", str(write_job(tmp_path, rows=rows, job=stamped)), "--out", str(tmp_path / "o"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["data"]["dt"] == pytest.approx(0.05)
    assert main(["run", str(write_job(tmp_path, rows=rows)), "--out", str(tmp_path / "none")]) == 2
    assert re.search(rf"unit.*{unit}|{unit}.*unit|rate is 20 Hz for a record of", sentence(capsys))


@pytest.mark.parametrize("json_", [[], ["--json"]])
def test_verdicts_on_a_model_that_runs_away_name_it(json_, tmp_path, capsys):
    """Its pole is moved out in the file: what 'validate' and 'compare' print, and the page, say so."""
    job = write_job(tmp_path, rows=noisy(), more=ARX + "inputs = ['delta']")
    main(["identify", str(job), "--out", str(tmp_path / "m"), "--json"])
    capsys.readouterr()
    file = tmp_path / "m" / "a.json"
    content = json.loads(file.read_text())
    content["record"]["fields"]["A"]["array"][0][0][0] = -2.5
    file.write_text(json.dumps(content))
    assert main(["validate", str(file), "--data", str(job), *json_]) == 0
    out, err = capsys.readouterr()
    assert "the free run of 'r' goes astray" in out
    files = [str(tmp_path / "m" / name) for name in ("a.json", "bicycle.json")]
    assert main(["compare", *files, "--data", str(job), "--out", str(tmp_path / "page"), *json_]) == 0
    assert "the free run of 'r' goes astray" in capsys.readouterr().out
    assert "goes astray" in (tmp_path / "page" / "index.html").read_text()
    assert "Warning" not in err


def test_a_heading_with_a_wrong_unit_is_overridden_where_the_sentence_says(tmp_path):
    """Steering in degrees under a heading that says rad."""
    wrong = write_job(tmp_path, head=("time", "steer [rad]", "speed", "yaw"))
    with pytest.raises(UnitError, match="override"):
        read_logs(read_settings(wrong))
    mended = write_job(
        tmp_path, head=("time", "steer [rad]", "speed", "yaw"), job=JOB.replace('"deg" }', '"deg", override = true }')
    )
    plain = tmp_path / "plain"
    plain.mkdir()
    expected = read_logs(read_settings(write_job(plain)))
    assert np.array_equal(read_logs(read_settings(mended)).data["delta"], expected.data["delta"])


def test_what_a_filter_leaves_in_single_samples_is_left_out(tmp_path):
    """A third of what it leaves: beyond 5 s two samples in a row now and then, which are one at the job's rate."""
    rows = log_rows()
    pairs = np.cumsum([104, *[7, 5, 9, 4, 6] * 9])
    for k in {*range(100, 400)} - {*pairs} - {*(pairs + 1)}:
        rows[k][1] = "9.0"
    job = write_job(tmp_path, rows=rows, job=JOB.replace("rate = 20.0", 'rate = 10.0\nfilter = "delta < 0.15"'))
    data = read_logs(read_settings(job)).data
    assert (data.n_samples, len(data.starts)) == (50, 1)
    assert f"{len(pairs)} samples in all" in " ".join(data.notes)
    assert data["v_x_dot"] == pytest.approx(np.gradient(data["v_x"], 0.1))
    alone = replace(data.rows(0, 3), starts=(0, 1), start_times=(0.0, 9.0))
    assert with_speed_derivative(alone)["v_x_dot"][0] == 0
