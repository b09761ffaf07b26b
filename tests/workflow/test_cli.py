"""The command line as a person or a machine meets it: output, exit codes, one sentence per kind of bad input."""

import contextlib
import io
import json
import os
import re
import subprocess
import sys
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from slipangle import cli
from slipangle import reproduce as experiments
from slipangle.cli import main
from slipangle.errors import WriteError
from slipangle.files import write_atomic
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM, SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.workflow import demo as made
from slipangle.workflow.drive import ControllerSettings, build_mpc

JOB = """
title = "test job"
[data]
file = "log.csv"
inputs = ["delta", "v_x"]
outputs = ["r"]
rate = 20.0
[data.columns]
delta = {{ column = "steer", unit = "deg" }}
v_x = {{ column = "speed", unit = "km/h" }}
r = {{ column = "yaw", unit = "deg/s" }}
[[model]]
name = "bicycle"
kind = "bicycle"
car = {{ mass = 1200, wheelbase = 2.6, l_f = 1.2, inertia_z = 1500, C_f = 8e4, C_r = 9e4 }}
{more}
"""


def log_rows(n=400, dt=0.05):
    t = np.arange(n) * dt
    steer = 2 * np.sin(0.9 * t) + np.sin(2.7 * t)
    return [[f"{a:.3f}" for a in row] for row in zip(t, steer, 80 + 5 * np.sin(0.2 * t), 12 * np.sin(0.9 * t - 0.1))]  # noqa: B905


def write_job(folder: Path, rows=None, head=("time", "steer", "speed", "yaw"), more="", job=JOB) -> Path:
    rows = log_rows() if rows is None else rows
    (folder / "log.csv").write_text("\n".join(",".join(r) for r in [head, *rows]) + "\n")
    path = folder / "job.toml"
    path.write_text(job.format(more=more))
    return path


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The demo, run once for all tests of its outcome."""
    folder = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as patch:  # a shorter log, and of dozens of cars four
        patch.setattr(made, "drive_log", partial(made.drive_log, seconds=90.0))
        patch.setattr(made, "_SETTINGS", made._SETTINGS.replace("width = 1.8\n", "width = 1.8\ncars = 4\n"))
        assert main(["demo", "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def identified(demo, tmp_path_factory):
    """What 'identify' says of the demo's job, run once: its models, with their files."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        assert (
            main(["identify", str(demo / "demo.toml"), "--out", str(tmp_path_factory.mktemp("found")), "--json"]) == 0
        )
    return json.loads(said.getvalue())


def test_demo_writes_page_log_and_job(demo):
    assert sorted(p.name for p in demo.iterdir()) == ["demo.toml", "drive_log.csv", "index.html", "metrics.json"]
    html = (demo / "index.html").read_text()
    markup = re.sub(r"<script.*?</script>", "", html, flags=re.S)  # plotly.js names addresses that nothing loads
    assert not re.findall(r"""(?:src|href)=["']https?:""", markup)
    assert "default-src 'none'" in html
    for heading in ("Verdict", "Parameters", "Residuals", "Data", "Closed loop"):
        assert heading in html


def test_the_page_names_one_steering_limit(demo):
    """The driver's own, over the drive that plays and in the figure, not the one that a job's MPC would have had."""
    page = (demo / "index.html").read_text()
    said = {float(v) for v in re.findall(r"of ±([\d.]+)°", page)}
    drawn = {float(v) for v in re.findall(r'"text":"limit ([\d.]+)"', page)}
    assert len(said) == 1
    assert said == {float(v) for v in re.findall(r"Steering is limited to ([\d.]+)°", page)}
    assert list(drawn) == [pytest.approx(*said, abs=0.06)]  # 28.85, said as 28.8


def test_demo_numbers(demo):
    found = json.loads((demo / "metrics.json").read_text())
    car = found["models"]["car"]
    assert car["free_run"]["r"]["fit"] > 95
    assert car["free_run"]["v_y"]["fit"] > 90
    assert found["closed_loop"]["inside_lane"] is True
    assert found["closed_loop"]["rmse_y"] < 0.05
    assert found["closed_loop"]["fallbacks"] == 0
    # the built-in car's own inertia and the slope of its tires, tables 6.1 and 6.2
    tire, load = SOUSA_TABLE_6_2.lateral, SOUSA_TABLE_6_1.mass * GRAVITY / 2
    stiffness = tire.B * tire.C * tire.D * load
    truths = {"inertia_z": 2200.0, "C_f": stiffness, "C_r": stiffness, "steering_gain": 1.0}
    for name, truth in truths.items():
        assert car["parameters"][name]["low"] < truth < car["parameters"][name]["high"], name


def test_a_verdict_stands_beside_simple_models_and_the_noise(demo, identified, capsys):
    """Words, numbers and page agree, and 'validate' on the saved model says the same."""
    found = json.loads((demo / "metrics.json").read_text())["models"]
    stands = found["car"]["standing"]["r"]
    assert stands["word"] == "good"
    assert list(stands["simple_models"]) == ["mean", "kinematic", "quasi-steady", "linear with lag"]
    fits = {name: score["fit"] for name, score in stands["simple_models"].items()}
    assert max(fits.values()) < found["car"]["free_run"]["r"]["fit"] <= stands["highest_fit"] < 100
    page = (demo / "index.html").read_text().replace("\N{NO-BREAK SPACE}", " ")
    assert "where its noise leaves at most" in page
    best = max(fits, key=fits.__getitem__)
    assert f"the best of the simple models ({best}) {fits[best]:.1f} %" in page
    assert "quasi-steady, a simple model" in page
    file = identified["car"]["file"]
    assert main(["validate", file, "--data", str(demo / "demo.toml"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["standing"]["r"]
    assert re.search(rf"^fits {found['car']['free_run']['r']['fit']:.1f} % of r where .*: good, ", said)


@pytest.mark.slow
def test_demo_can_be_run_again_from_its_own_files(tmp_path, capsys):
    """As long as it is, and tried on as many cars, for whoever types the command."""
    demo = tmp_path / "demo"
    assert main(["demo", "--out", str(demo)]) == 0
    capsys.readouterr()
    assert main(["run", str(demo / "demo.toml"), "--out", str(tmp_path / "again"), "--json"]) == 0
    out = capsys.readouterr().out
    again, first = json.loads(out), json.loads((demo / "metrics.json").read_text())
    assert again["free_run"] == first["free_run"]
    assert again["free_run"]["r"].keys() >= {"fit", "vaf", "rmse"}


def test_the_log_is_made_of_what_sensors_see(demo):
    text = (demo / "demo.toml").read_text()
    head = (demo / "drive_log.csv").read_text().splitlines()[0]
    assert head.startswith("time [s],steer [deg],speed [km/h]")
    assert not re.search(r"(C_f|C_r|inertia_z|steering_gain) *=", text)  # what is to be found out


@pytest.mark.parametrize(
    "args", [["--help"], ["run", "--help"], ["demo", "--help"], ["data", "--help"], ["reproduce", "-h"]]
)
def test_help_teaches(args, capsys):
    with pytest.raises(SystemExit) as stop:
        main(args)
    assert stop.value.code == 0
    assert len(capsys.readouterr().out.splitlines()) > 8


def sentence(capsys, code=2):
    """The one sentence on standard error; nothing on standard output."""
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("slipangle: ")
    assert len(err.strip().splitlines()) == 1
    return err


def bad(cell, row, column):
    rows = log_rows()
    rows[row][column] = cell
    return rows


BAD_LOGS = {
    "missing column": ({"head": ("time", "stear", "speed", "yaw")}, r"no column 'steer'.*'stear'"),
    "non-numeric cell": ({"rows": bad("oops", 7, 2)}, r"'oops'.*(line 9|row 8|row 7).*|(line 9|row).*'oops'"),
    "NaN run": ({"rows": bad("nan", 7, 2)}, r"v_x|speed"),
    "time goes back": ({"rows": bad("0.01", 50, 0)}, r"time|goes back"),
    "mixed sample times": (
        {"rows": [[f"{k * 0.05 if k < 200 else 10 + (k - 200) * 0.02:.3f}", *r[1:]] for k, r in enumerate(log_rows())]},
        r"sample time|0\.02|50 Hz",
    ),
    "constant input": ({"rows": [[r[0], "1.0", *r[2:]] for r in log_rows()]}, r"'delta'.*constant"),
    "too short": ({"rows": log_rows(6)}, r"samples"),
    "empty": ({"rows": []}, r"no (row|sample|number|data)|empty|holds"),
}


@pytest.mark.parametrize("case", BAD_LOGS)
@pytest.mark.parametrize("flag", [[], ["--json"]])
def test_bad_logs_get_a_sentence_and_nothing_is_written(case, flag, tmp_path, capsys):
    given, expected = BAD_LOGS[case]
    job = write_job(tmp_path, **given)
    before = sorted(p.name for p in tmp_path.iterdir())
    assert main(["run", str(job), "--out", str(tmp_path / "out"), *flag]) == 2
    said = sentence(capsys)
    assert re.search(expected, said), said
    assert sorted(p.name for p in tmp_path.iterdir()) == before


BAD_JOBS = {
    "unknown entry": ("[[model]]\nname = 'b'\nkind = 'arx'\nma = 2", r"no entry 'ma'; nearest are .*'na'"),
    "unknown kind": ("[[model]]\nname = 'b'\nkind = 'bicicle'", r"'bicicle'.*nearest are 'bicycle'"),
    "wrong type": ("[[model]]\nname = 'b'\nkind = 'arx'\nna = 'two'", r"na is 'two'; expected a whole number"),
    "unknown parameter": ("free = ['C_F']", r"no parameter 'C_F'; nearest are 'C_f'"),
    "stages that are not as many as the horizon": (
        "[controller]\nmodel = 'bicycle'\nhorizon = 3\nsteps = [1, 2]\n[plant]\ncatalogue = 'sousa-table-6.1'",
        r"steps.*3",
    ),
    "unknown controller model": ("[controller]\nmodel = 'bike'", r"uses the model 'bike'; nearest are|there are"),
    "not TOML": ("]", r"not valid TOML"),
    "repeated name": ("[[model]]\nname = 'bicycle'\nkind = 'arx'", r"names repeat"),
}


@pytest.mark.parametrize("case", BAD_JOBS)
def test_bad_jobs_get_a_sentence(case, tmp_path, capsys):
    more, expected = BAD_JOBS[case]
    assert main(["run", str(write_job(tmp_path, more=more)), "--out", str(tmp_path / "out")]) == 2
    said = sentence(capsys)
    assert re.search(expected, said), said
    assert not (tmp_path / "out").exists()


def test_unit_of_another_quantity(tmp_path, capsys):
    job = JOB.replace('unit = "deg/s"', 'unit = "km/h"')
    assert main(["run", str(write_job(tmp_path, job=job))]) == 2
    assert re.search(r"'?r'?.*(speed|km/h).*angular rate", sentence(capsys))


def test_model_at_another_sample_time(tmp_path, capsys):
    more = (
        "[[model]]\nname = 'arx'\nkind = 'arx'\n[controller]\nmodel = 'arx'\ndt = 0.02\n"
        "[plant]\ncatalogue = 'sousa-table-6.1'"
    )
    assert main(["run", str(write_job(tmp_path, more=more)), "--out", str(tmp_path / "out")]) == 2
    assert re.search(r"0\.02 s.*0\.05 s", sentence(capsys))


def test_stages_of_several_steps():
    car = Bicycle(params=FERRARI_250LM, dt=0.05)
    mpc = build_mpc(car, ControllerSettings(model="car", dt=0.02), horizon=3, steps=(1, 2, 4))
    assert mpc.times == pytest.approx([0.0, 0.02, 0.06, 0.14])


def test_missing_files(tmp_path, capsys):
    assert main(["run", str(tmp_path / "nothing.toml")]) == 2
    assert "nothing.toml" in sentence(capsys)
    job = write_job(tmp_path)
    (tmp_path / "log.csv").unlink()
    assert main(["run", str(job), "--out", str(tmp_path / "out")]) == 2
    assert "log.csv" in sentence(capsys)
    assert not (tmp_path / "out").exists()


def test_output_that_cannot_be_written(tmp_path, capsys):
    job = write_job(tmp_path)
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert main(["run", str(job), "--out", str(blocked / "out")]) == 2
    assert "cannot be" in sentence(capsys)
    assert main(["demo", "--out", "/proc/slipangle"]) == 2
    assert "cannot be" in sentence(capsys)


def test_models_as_files(demo, identified, tmp_path, capsys):
    """Identify, then validate and compare from the files give the demo's own numbers."""
    job, written = str(demo / "demo.toml"), identified
    files = [entry["file"] for entry in written.values()]
    assert sorted(written) == ["ARX(4, 4)", "car"]
    assert main(["validate", written["car"]["file"], "--data", job, "--json"]) == 0
    verdict = json.loads(capsys.readouterr().out)
    known = json.loads((demo / "metrics.json").read_text())["models"]["car"]
    assert verdict["free_run"]["r"] == pytest.approx(known["free_run"]["r"], rel=1e-9)
    assert verdict["one_step_ahead"]["v_y"] == pytest.approx(known["one_step_ahead"]["v_y"], rel=1e-9)
    assert main(["compare", *files, "--data", job, "--json"]) == 0
    assert [row["model"] for row in json.loads(capsys.readouterr().out)] == ["car", "arx-4-4"]
    assert main(["compare", *files, "--data", job, "--out", str(tmp_path / "page")]) == 0
    page = (tmp_path / "page" / "index.html").read_text()
    assert "Error over the horizon, r" in page
    assert "replaces" not in capsys.readouterr().out
    assert main(["compare", files[0], "--data", job, "--out", str(tmp_path / "page")]) == 0
    assert "index.html, which replaces the one of" in capsys.readouterr().out
    assert main(["validate", files[0], "--data", job, "--whole"]) == 2
    assert "used to fit the model" in sentence(capsys)
    assert main(["validate", job, "--data", job]) == 2
    sentence(capsys)


def test_every_kind_of_black_box_becomes_a_file(tmp_path, capsys):
    rng = np.random.default_rng(0)
    steer, yaw = rng.standard_normal(420), np.zeros(420)
    for k in range(2, 420):
        yaw[k] = 1.4 * yaw[k - 1] - 0.6 * yaw[k - 2] + 0.8 * steer[k - 1] + 0.05 * rng.standard_normal()
    rows = [[f"{v:.4f}" for v in (0.05 * k, steer[k], 80 + np.sin(0.2 * k), yaw[k])] for k in range(420)]
    kinds = {name: f"kind = '{name}'" for name in ("arx", "armax", "output-error", "box-jenkins")}
    kinds["state space"] = "kind = 'state-space'\norder = [1, 2]"
    kinds["free-run state space"] = "kind = 'state-space'\norder = [2]\nfocus = 'simulation'"
    more = "\n".join(f"[[model]]\nname = '{name}'\ninputs = ['delta']\n{text}" for name, text in kinds.items())
    job = write_job(tmp_path, rows=rows, more=more)
    assert main(["identify", str(job), "--out", str(tmp_path / "models"), "--json"]) == 0
    files = [entry["file"] for entry in json.loads(capsys.readouterr().out).values()]
    assert main(["compare", *files, "--data", str(job), "--json"]) == 0
    fits = {row["model"]: row["free_run"]["r"]["fit"] for row in json.loads(capsys.readouterr().out)}
    assert len(fits) == 7
    assert all(fit > 90 for name, fit in fits.items() if name != "bicycle"), fits


def test_what_hangs_together_is_said_where_it_means_something(tmp_path, capsys):
    """Of a state space every basis fits alike; of a bicycle the stiffnesses hang together."""
    more = "[[model]]\nname = 'black box'\ninputs = ['delta']\nkind = 'state-space'\norder = 2"
    assert main(["identify", str(write_job(tmp_path, more=more)), "--out", str(tmp_path / "models")]) == 0
    physics, black_box = capsys.readouterr().out.split("black box:")
    assert "condition number" in physics
    assert "other states give the same outputs" not in physics
    assert "other states give the same outputs" in black_box
    assert "condition number" not in black_box


def test_reproduce_and_bench_names(capsys):
    assert main(["reproduce", "--json"]) == 0
    assert "table-8.2" in json.loads(capsys.readouterr().out)
    assert main(["bench"]) == 0
    assert "free-run" in capsys.readouterr().out
    assert main(["reproduce", "table-8.3x"]) == 2
    assert "table-8.3" in sentence(capsys)
    assert main(["bench", "nothing"]) == 2
    sentence(capsys)


def test_every_named_experiment_and_benchmark_can_run():
    for name in experiments.names():
        assert callable(experiments.find(name).reproduce), name
    # in a process that has the checkout nowhere on its path: no benchmark lives off what another put there
    load = """
import sys
from slipangle import reproduce
clean = list(sys.path)
for name in reproduce.benchmark_names():
    assert callable(reproduce.find_benchmark(name).bench), name
    sys.path[:] = clean
    for module in [module for module in sys.modules if module.partition(".")[0] == "benchmarks"]:
        del sys.modules[module]
"""
    loaded = subprocess.run([sys.executable, "-c", load], cwd="/", capture_output=True, text=True, check=False)
    assert loaded.returncode == 0, loaded.stderr


def test_a_table_that_is_done_says_so(monkeypatch, capsys):
    from slipangle.commands import reproduce
    from slipangle.reproduce import Reproduction, table_8_2

    told = []
    monkeypatch.setattr(reproduce.Bar, "__call__", lambda self, share, what: told.append(share))
    monkeypatch.setattr(table_8_2, "reproduce", lambda progress: Reproduction(title="t", records=(), protocol="p"))
    assert main(["reproduce", "table-8.2", "--json"]) == 0
    assert told[-1] == 1.0


def test_a_bound_broken_in_numpys_words_is_broken():
    from slipangle.report.records import Record
    from slipangle.reproduce import Reproduction

    kept, asked, broken = (Record("x", "y", None, 2.0, holds=holds) for holds in (np.True_, None, np.False_))
    assert Reproduction(title="t", records=(kept, asked), protocol="p").holds
    assert not Reproduction(title="t", records=(kept, asked, broken), protocol="p").holds


def test_a_broken_bound_is_exit_code_1(monkeypatch, capsys):
    from slipangle.report.records import Record
    from slipangle.reproduce import Reproduction, table_8_2

    bad = Record(row="x", quantity="y", thesis=1.0, here=2.0, bound="<= 1", holds=False)
    monkeypatch.setattr(table_8_2, "reproduce", lambda progress: Reproduction(title="t", records=(bad,), protocol="p"))
    assert main(["reproduce", "table-8.2", "--json"]) == 1
    rows = json.loads(capsys.readouterr().out)
    assert rows == [
        {
            "name": "table-8.2",
            "row": "x",
            "quantity": "y",
            "thesis": 1.0,
            "here": 2.0,
            "bound": "<= 1",
            "holds": False,
            "note": "",
        }
    ]


def test_data_commands(capsys, real_data):
    real_data("daisy_robot_arm/robot_arm.dat")
    assert main(["data", "list", "--json"]) == 0
    assert {"ferrari-250lm", "robot-arm"} <= {s["name"] for s in json.loads(capsys.readouterr().out)}
    assert main(["data", "check", "robot-arm", "--json"]) == 0
    assert all(f["as_published"] for f in json.loads(capsys.readouterr().out)["robot-arm"])
    assert main(["data", "get", "robot-arm", "--json"]) == 0
    assert all(os.path.exists(p) for p in json.loads(capsys.readouterr().out)["robot-arm"].values())
    assert main(["data", "get", "ferari"]) == 2
    assert "ferrari-250lm" in sentence(capsys)


EXAMPLE = Path(__file__).parents[2] / "examples" / "ferrari_250lm.toml"


def require_words_of_the_real_log(html: str, linear: dict) -> None:
    for number in ("72.87", "93.21", "3.09\N{NO-BREAK SPACE}deg/s", f"{linear['fit']:.2f}"):
        assert number in html
    assert "follows delta by" in html
    for t in ("207.27", "503.49", "524.85", "671.67"):
        assert re.search(rf"delta has a spike of [^<]* at t = {t}\s", html)


def test_linear_models_of_the_real_log_beat_the_thesis(real_data, tmp_path, capsys):
    """The numbers on the page and in the JSON, and the page's own words about delay and spikes."""
    lines = EXAMPLE.read_text()
    car, rest = lines.index("[[model]]"), lines.index('[[model]]\nname = "bicycle (3')
    job = tmp_path / "job.toml"
    job.write_text(lines[:car] + lines[rest : lines.index("[controller]")])
    assert main(["run", str(job), "--out", str(tmp_path / "out"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    linear = found["models"]["bicycle (3 parameters)"]["free_run"]["r"]
    assert found["free_run"] == found["models"]["bicycle (3 parameters)"]["free_run"]
    assert linear["fit"] >= 79.0
    assert linear["vaf"] >= 95.5
    assert found["models"]["bicycle (6 parameters)"]["free_run"]["r"]["fit"] >= 81.5
    require_words_of_the_real_log((tmp_path / "out" / "index.html").read_text(), linear)


@pytest.mark.slow
def test_ferrari_run_beats_the_thesis(real_data, tmp_path, capsys):
    """The whole example, with the car that is found of the real log, and its drive."""
    assert main(["run", str(EXAMPLE), "--out", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["free_run"] == found["models"]["car"]["free_run"]
    assert found["free_run"]["r"]["fit"] >= 88.0
    assert found["closed_loop"]["inside_lane"] is True
    html = (tmp_path / "index.html").read_text()
    require_words_of_the_real_log(html, found["models"]["bicycle (3 parameters)"]["free_run"]["r"])
    assert "inertia_z is not identifiable without knowing the steering delay" in html


def test_a_page_speaks_si_where_it_is_asked_to(tmp_path, capsys):
    """Nothing that a reader sees is in degrees, km/h or, but for the solver's time, ms; the numbers are the same."""
    job, pages, fits = write_job(tmp_path), [], []
    for more in ([], ["--si"]):
        assert main(["run", str(job), "--out", str(tmp_path / "out"), "--json", *more]) == 0
        fits.append(json.loads(capsys.readouterr().out))
        pages.append((tmp_path / "out" / "index.html").read_text())
    for words in ("deg/s", "km/h"):
        assert [words in page for page in pages] == [True, False], words
    shown = re.sub(
        r"<script(?! type=\"application/json\").*?</script>|<style.*?</style>", "", pages[1], flags=re.DOTALL
    )
    assert re.findall(r".{30}(?:\d°|\bdeg\b|\[deg).{10}", shown) == []
    assert "rad/s" in shown
    assert fits[0]["free_run"] == fits[1]["free_run"]


def test_a_terminal_without_a_letter_shows_another(monkeypatch):
    """Of what is printed in the end: the job was done, and its exit code is its own."""
    shown = io.TextIOWrapper(io.BytesIO(), encoding="latin-1")
    monkeypatch.setattr(sys, "stdout", shown)
    monkeypatch.setattr(cli, "run", lambda options: print("\u201cgood\u201d \xb1 1") or 0)
    assert main(["list"]) == 0
    assert shown.buffer.getvalue().decode("latin-1").strip() == "?good? \xb1 1"


def test_a_disk_that_is_full_and_a_folder_that_is_gone_are_a_sentence(monkeypatch, capsys):
    for error in (OSError(28, "No space left on device"), FileNotFoundError(2, "No such file or directory", "gone")):
        monkeypatch.setattr(cli, "run", Mock(side_effect=error))
        assert main(["list"]) == 2
        assert capsys.readouterr().err.startswith(f"slipangle: {error.strerror}")
    with pytest.raises(WriteError, match=r"cannot be written .*name another"):
        write_atomic(Path("a" * 300), "text")
