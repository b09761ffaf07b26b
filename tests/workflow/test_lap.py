"""``slipangle lap``: a page and a table of the fastest lap of a job's car."""

import json
import re

import numpy as np
import pytest

import slipangle as sa
from slipangle.cli import main
from slipangle.data.race import EARTH
from slipangle.report.lap import lap_playback
from tests.optimal.lap.cars import RACER, circuit
from tests.workflow.test_cli import write_job

CAR = """[[model]]
name = "limit"
kind = "saturating-bicycle"
car = { mass = 1500.0, inertia_z = 2500.0, wheelbase = 2.7, l_f = 1.2, C_f = 9e4, C_r = 1.1e5 }
free = ["C_f", "C_r"]
"""


@pytest.fixture
def files(tmp_path):
    track = circuit()
    table = np.column_stack([track.X, track.Y, track.right, track.left])[:-1:20]
    np.savetxt(tmp_path / "track.csv", table, delimiter=",")
    return str(write_job(tmp_path, more=CAR)), str(tmp_path / "track.csv"), tmp_path


def test_the_command_writes_a_page_and_the_lap(files, capsys):
    job, track, folder = files
    out = folder / "out"
    assert main(["lap", job, track, "--set", "power=1.5e5", "--points", "60", "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["sensitivities"]["power"] < 0
    assert "taken were no drag (drag=0 kg/m), driven rear wheels" in said["supposed"]
    page = (out / "index.html").read_text()
    for words in ("The line, by speed", "g-g diagram", "What one percent more is worth", "taken were no drag"):
        assert words in page
    head, *rows = (out / "lap.csv").read_text().splitlines()
    assert len(rows) == 60
    assert float(rows[-1].split(",")[head.split(",").index("t")]) == pytest.approx(said["time"], rel=1e-4)


def test_what_is_missing_is_named(files, capsys):
    job, track, _ = files
    for given, words in (
        (["--set", "powr=1e5"], "'power'"),
        (["--set", "power=much"], "expected a number"),
        (["--model", "lmit"], "'limit'"),
        (["--points", "60"], "power"),
    ):
        assert main(["lap", job, track, *given]) == 2
        assert words in capsys.readouterr().err


def test_a_driven_log_is_held_against_the_lap(files, capsys):
    """Two laps along the middle at 10 m/s: the lap of the log takes as long as the track is."""
    job, track, folder = files
    middle = circuit()
    s = np.arange(0.0, 2.3 * middle.length, 0.5)
    place = middle.at(s)
    table = np.column_stack([s / 10.0, place.X, place.Y])
    np.savetxt(folder / "driven.csv", table, delimiter=",", header="t [s],X [m],Y [m]", comments="")
    how = ["--set", "power=1.5e5", "--points", "60", "--driven", str(folder / "driven.csv"), "--out", str(folder / "o")]
    assert main(["lap", job, track, *how, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["driven"]["time"] == pytest.approx(middle.length / 10.0, abs=0.1)
    lost = [sector["lost"] for sector in said["driven"]["sectors"]]
    assert sum(lost) == pytest.approx(said["driven"]["time"] - said["time"], rel=1e-6)
    page = (folder / "o" / "index.html").read_text()
    assert "Driven and fastest" in page
    assert "Beside it: the driven lap" in page
    assert main(["lap", job, track, *how]) == 0
    assert "you lose" in capsys.readouterr().out


def test_a_job_says_where_the_track_of_a_gps_log_lies(files, capsys):
    """The log begins far from the track's zero: two laps by latitude and longitude, which count from `origin`."""
    job, _, folder = files
    middle = circuit()
    s = np.arange(0.3, 2.5, 0.5 / middle.length) * middle.length
    place = middle.at(s)
    lat = 52.0 + np.degrees(place.Y / EARTH)
    lon = 13.0 + np.degrees(place.X / (EARTH * np.cos(np.radians(52.0))))
    table = np.column_stack([(s - s[0]) / 10.0, lat, lon])
    np.savetxt(folder / "gps.csv", table, delimiter=",", header="t [s],latitude [deg],longitude [deg]", comments="")
    with open(job, "a") as opened:
        opened.write('\n[lap]\ntrack = "track.csv"\npoints = 60\nset = { power = 1.5e5 }\norigin = [52.0, 13.0]\n')
    assert main(["lap", job, "--driven", str(folder / "gps.csv"), "--out", str(folder / "o"), "--json"]) == 0
    driven = json.loads(capsys.readouterr().out)["driven"]
    assert driven["time"] == pytest.approx(middle.length / 10.0, abs=0.1)


def test_the_lap_that_plays_is_the_lap():
    lap = sa.fastest_lap(RACER, circuit(), points=60)
    shown = lap_playback(lap)
    step = np.hypot(np.diff(shown.X), np.diff(shown.Y)) / np.diff(shown.t)
    assert len(shown.t) == len(shown.said) == pytest.approx(lap.time / 0.05, abs=1)
    assert step == pytest.approx(np.interp(np.array(shown.t[1:]) - 0.025, lap.t, lap.v_x), rel=0.05)
    assert np.abs(np.diff(shown.psi)).max() < 0.2


def test_the_lap_of_a_small_car_plays_between_its_edges():
    """The car is drawn as large as it is, on edges that bend as the track does, all the way round."""
    angle = np.linspace(0, 2 * np.pi, 100)[:-1]
    small = {"mass": 2.6, "inertia_z": 0.035, "wheelbase": 0.26, "l_f": 0.13, "C_f": 45.0, "C_r": 60.0, "width": 0.19}
    car = sa.LapCar(**small, mu_f=0.9, mu_r=0.9, power=60.0, drag=0.01)
    how = {"closed": True, "right": 0.5, "left": 0.5, "spacing": 0.02}
    lap = sa.fastest_lap(car, sa.Path.from_points(3.0 * np.cos(angle), 2.0 * np.sin(angle), **how), points=60)
    drawn = lap_playback(lap).svg
    shapes = [
        np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", d), dtype=float) for d in re.findall(r' d="([^"]*)"', drawn)
    ]
    for edge, true in zip(shapes[:2], lap.track.boundaries()[::-1], strict=True):
        assert np.hypot(*np.diff(edge, axis=0).T).sum() == pytest.approx(
            np.hypot(*np.diff(true, axis=0).T).sum(), rel=0.01
        )
        np.testing.assert_array_equal(edge[0], edge[-1])
    assert np.ptp(shapes[-1], axis=0) == pytest.approx([0.44, 0.19], abs=0.02)


def test_a_job_says_what_lap_it_wants(files, capsys):
    job, track, folder = files
    with open(job, "a") as opened:
        opened.write('\n[lap]\ntrack = "track.csv"\npoints = 60\nmargin = 0.2\nset = { power = 1.5e5 }\n')
    how = ["--out", str(folder / "o"), "--json"]
    assert main(["lap", job, *how]) == 0
    said = json.loads(capsys.readouterr().out)
    assert main(["lap", job, track, "--margin", "0.0", *how]) == 0
    assert json.loads(capsys.readouterr().out)["time"] < said["time"]  # the command's word counts before the job's
    assert main(["lap", job, "--set", "power=2e5", *how]) == 0
    assert json.loads(capsys.readouterr().out)["time"] < said["time"]


def test_a_job_smooths_its_track(files, capsys):
    """A track with noise is warned of, which is an error here, unless the job says how much there is."""
    job, _, folder = files
    track, rng = circuit(), np.random.default_rng(0)
    X, Y = (c[:-1:11] + 0.2 * rng.normal(size=len(c[:-1:11])) for c in (track.X, track.Y))
    np.savetxt(folder / "track.csv", np.column_stack([X, Y, 5.0 + 0 * X, 5.0 + 0 * X]), delimiter=",")
    with open(job, "a") as opened:
        opened.write('\n[lap]\ntrack = "track.csv"\nsmoothing = 0.2\npoints = 60\nset = { power = 1.5e5 }\n')
    assert main(["lap", job, "--out", str(folder / "out"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["time"] == pytest.approx(26.6, rel=0.2)


def test_a_job_without_a_track_is_named(files, capsys):
    job, _, _ = files
    assert main(["lap", job, "--set", "power=1.5e5"]) == 2
    assert "names no track" in capsys.readouterr().err
    with open(job, "a") as opened:
        opened.write('\n[lap]\ntrack = "track.csv"\nset = { powr = 1.5e5 }\n')
    assert main(["lap", job]) == 2
    assert "'power'" in capsys.readouterr().err
