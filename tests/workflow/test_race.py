"""``[race]`` of a job: a racer on a plant that is another model, judged by the edges."""

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path as File

import numpy as np
import pytest

import slipangle as sa
from slipangle.cli import main
from slipangle.codegen.compiler import compiler
from slipangle.codegen.compiler import sentence as no_compiler
from slipangle.control.racing.sensing import NOISE
from slipangle.errors import ConfigError
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE
from slipangle.models.vehicles.on_tires import peak_friction_along
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycle, SaturatingBicycleParams
from slipangle.models.vehicles.steering import Steered
from slipangle.optimal.lap.cars import lap_car
from slipangle.report.page import Page
from slipangle.simulate.race import race
from slipangle.simulate.race_car import fitted, optimum
from slipangle.simulate.run import End
from slipangle.workflow import race as race_module
from slipangle.workflow.drive import PlantSettings
from slipangle.workflow.race import Raced, metrics, plant_of, section, sentence, word
from slipangle.workflow.race_settings import RaceSettings
from slipangle.workflow.settings import read_settings
from tests.control.racing.test_racer import FRICTION, MARGIN, PEDALS, believed, car_on, first_lap
from tests.optimal.lap.cars import RACER, circuit
from tests.workflow.test_cli import write_job
from tests.workflow.test_lap import CAR

NEEDS_C = pytest.mark.skipif(compiler() is None, reason=no_compiler())
ROOT = File(__file__).parents[2]
AXLES = {"mass": 1500.0, "inertia_z": 2500.0, "wheelbase": 2.7, "l_f": 1.2, "C_f": 9e4, "C_r": 1.1e5}
LAP = '\n[lap]\ntrack = "track.csv"\npoints = 60\nset = { power = 1.5e5 }\n'


def job(folder, more):
    track = circuit()
    np.savetxt(
        folder / "track.csv", np.column_stack([track.X, track.Y, track.right, track.left])[:-1:20], delimiter=","
    )
    return str(write_job(folder, more=CAR + more))


@cache
def one_lap():
    racer = sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), margin=MARGIN, between=False)
    plant = sa.Plant(car_on(FRICTION), noise=sa.Values(**NOISE), seed=1)
    found = race(racer, plant, 1)
    return Raced(
        race=found, fastest=optimum(believed(), circuit(), FRICTION, 80), plant="a dual track", settings=RaceSettings()
    )


@NEEDS_C
def test_a_lap_is_timed_at_the_start_line_and_its_room_is_that_of_the_car_s_side():
    found = one_lap().race
    run = found.run
    crossed = [float(np.interp(k * run.path.length, run.s, run.t)) for k in (0, 1)]
    assert found.times == pytest.approx([crossed[1] - crossed[0]], abs=0.02)
    assert found.finished
    k = int(np.argmin(found.room))
    edges = [np.asarray(edge) for edge in circuit().boundaries()]
    nearest = min(float(np.hypot(*(edge - [run["X"][k], run["Y"][k]]).T).min()) for edge in edges)
    assert found.room[k] == pytest.approx(nearest - 0.5 * run.width, abs=0.05)
    assert found.learned[0, 0] == pytest.approx(1.0)  # nobody let it learn
    assert found.grip[found.judged][-1] == pytest.approx(FRICTION, abs=0.06)


@NEEDS_C
def test_the_page_and_the_numbers_say_the_same():
    found = one_lap()
    said = metrics(found)
    assert said["word"] == word(found)
    assert said["laps"][0]["time"] == found.race.times[0]
    assert said["laps"][0]["over_optimum"] > 0.0
    lost = sum(one["lost"] for one in said["corners"])
    assert lost == pytest.approx(found.race.times[0] - found.fastest.time, rel=1e-6)
    assert min(one["room"] for one in said["corners"]) == pytest.approx(said["room"])
    page = Page(title="t", sections=(section(found, "c"),)).to_html()
    for words in ("another model than the one", "The line driven, lap 1", "Lap times", "Corners of lap 1"):
        assert words in page
    assert "Off the track" not in page
    json.dumps(said, allow_nan=False)


@NEEDS_C
def test_a_drive_that_left_the_track_is_poor_whatever_its_times():
    found = one_lap()
    run = found.race.run
    assert word(found) == "good"
    e_y, k = run.e_y.copy(), len(run.t) // 2
    e_y[k : k + 30] = run.path.at(run.s[k : k + 30]).left  # the car's left half is beyond the left edge for 0.3 s
    off = replace(found, race=replace(found.race, run=replace(run, e_y=e_y)))
    assert word(off) == "poor"
    (moment,) = off.race.off_track
    assert (moment.begin, moment.end) == pytest.approx((run.t[k], run.t[k] + 0.3))
    assert moment.depth == pytest.approx(0.5 * run.width)
    assert "it left the track once, by up to" in sentence(off)
    assert "stayed on the track" not in sentence(off)
    assert "Off the track" in Page(title="t", sections=(section(off, "c"),)).to_html()
    assert metrics(off)["off_track"]


@NEEDS_C
def test_a_drive_without_its_laps_is_poor_and_has_a_page():
    found = one_lap()
    stuck = replace(found.race, laps=(), learned=np.empty((0, 2)), run=replace(found.race.run, end=End.LEFT_PATH))
    none = replace(found, race=stuck)
    assert word(none) == "poor"
    assert sentence(none).startswith("0 of 1 laps")
    assert "ended early" in sentence(none)
    assert metrics(none)["corners"] == []
    assert "The line driven" in Page(title="t", sections=(section(none, "c"),)).to_html()


@NEEDS_C
def test_laps_faster_than_the_optimum_are_not_good():
    found = one_lap()
    slow = replace(found.fastest, t=found.fastest.t * 1.2, time=found.fastest.time * 1.2)
    better = replace(found, fastest=slow)
    assert word(better) == "fair"
    assert "faster than what should be fastest" in sentence(better)


def test_the_stand_in_is_the_car_as_a_lap_sees_it():
    """Read back from the dual track, the car of the lap has stiffness, friction, drive and air as before."""
    plant, said = plant_of(RaceSettings(), PlantSettings(), None, RACER)
    back = lap_car(plant)
    assert "stand-in" in said
    for name in (
        "mass",
        "inertia_z",
        "l_f",
        "C_f",
        "C_r",
        "mu_f",
        "mu_r",
        "shape",
        "drag",
        "downforce_f",
        "downforce_r",
    ):
        assert getattr(back, name) == pytest.approx(getattr(RACER, name), rel=0.01), name
    for name in ("drive_rear", "brake_rear", "transfer_x", "power"):
        assert getattr(back, name) == pytest.approx(getattr(RACER, name), rel=0.02), name
    load = 0.25 * RACER.weight
    assert peak_friction_along(plant.tire_f, load) == pytest.approx(RACER.mu_f * RACER.mu_x, rel=0.01)


def test_tires_of_files_are_raced_with_the_car_s_own_power(tmp_path):
    file = str(PASSENGER_TIRE.write_tir(tmp_path / "tire.tir"))
    turned = replace(RACER, steering_gain=0.07)
    plant, said = plant_of(RaceSettings(), PlantSettings(tire=file, friction=0.9), None, turned)
    assert "tire.tir" in said
    assert plant.params.steering_gain == 1.0
    assert plant.road.friction == (0.9,) * 4
    assert lap_car(plant).power == pytest.approx(RACER.power, rel=0.02)


@NEEDS_C
@pytest.mark.parametrize(("plant", "lag", "delay"), [("", 0.12, 0.04), ("bmw-320i", 0.0, 0.0)])
def test_the_car_s_own_steering_is_as_late_as_identified_and_the_racer_knows(monkeypatch, plant, lag, delay):
    car = Steered(SaturatingBicycle(params=SaturatingBicycleParams(**AXLES), dt=0.05), steering_lag=0.12)
    model = sa.Delayed(car, delays={"delta": 0.04})
    made = []
    monkeypatch.setattr(race_module, "race_car", lambda real, track, **how: believed())
    monkeypatch.setattr(race_module, "optimum", lambda *of: first_lap())
    monkeypatch.setattr(race_module, "race", lambda *of: made.append(of))
    settings = RaceSettings(plant=plant, share=0.86)
    race_module.raced(settings, PlantSettings(), model, RACER, circuit(), 60, lambda share, what: None)
    racer, driven, _ = made[0]
    assert driven.lag.get("delta", 0.0) == lag
    assert driven.delay.get("delta", 0.0) == delay
    assert len(racer._actuators.coming) == round(delay / 0.01)
    assert ("delta_asked" in racer._planner.mpc.model.states) == (lag > 0)


@NEEDS_C
def test_a_fitted_car_bends_as_its_plant():
    plant, _ = plant_of(RaceSettings(), PlantSettings(), None, RACER)
    car = fitted(lap_car(plant), plant, (15.0, 25.0))
    assert car.mu_f == pytest.approx(RACER.mu_f, rel=0.1)
    assert car.mu_x == pytest.approx(RACER.mu_x, rel=0.02)


def test_a_plant_that_cannot_be_raced_is_refused():
    with pytest.raises(ConfigError, match="no pedals"):
        plant_of(RaceSettings(), PlantSettings(catalogue="sousa-table-6.1"), None, RACER)
    stiff = replace(RACER, C_f=2e6, mu_f=0.3)
    with pytest.raises(ConfigError, match="no dual track can stand for the car"):
        plant_of(RaceSettings(), PlantSettings(), None, stiff)
    catalogue, said = plant_of(RaceSettings(plant="bmw-320i"), PlantSettings(), None, RACER)
    assert catalogue.params.driveline.ratios[0] > 3
    assert "BMW 320i" in said


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("lap = 3", "'laps'"),
        ("laps = 0", "expected 1 to 100"),
        ('plant = "bmw"', "'bmw-320i'"),
        ("friction = 3.0", "expected 0.3 to 1.5"),
        ("share = 1.2", "expected 0.3 to 1"),
        ("margin = -0.1", "expected 0 to 10 m"),
        ("noise = { v_y = 0.1 }", "noise names 'v_y'"),
    ],
)
def test_wrong_entries_are_named(tmp_path, capsys, wrong, words):
    path = job(tmp_path, f"{LAP}[race]\n{wrong}\n")
    assert main(["lap", path]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_the_job_of_the_documentation_can_be_read(tmp_path):
    """Its defaults are those of the records, so that leaving them out changes nothing."""
    (block,) = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "fastest-lap.md").read_text(encoding="utf-8"), re.S)
    assert read_settings(job(tmp_path, block)).race == RaceSettings(plant="bmw-320i", margin=0.4)


@pytest.mark.slow
@NEEDS_C
@pytest.mark.parametrize("plant", ["", "bmw-320i"])
def test_a_job_races(tmp_path, capsys, plant):
    more = LAP.replace("1.5e5", "1.2e5, mu_f = 1.1, mu_r = 1.15, C_f = 1.2e5, C_r = 1.6e5")
    path = job(tmp_path, f'{more}[race]\nlaps = 2\nplant = "{plant}"\n')
    code = main(["lap", path, "--out", str(tmp_path / "o"), "--json"])
    said = json.loads(capsys.readouterr().out)["race"]
    assert code == (1 if said["word"] == "poor" else 0)
    assert said["word"] == "good"
    assert len(said["laps"]) == 2
    assert said["room"] > 0.0
    assert said["laps"][-1]["grip"] == pytest.approx(0.95, abs=0.05)
    assert "The race" in (tmp_path / "o" / "index.html").read_text()


@pytest.mark.slow
@NEEDS_C
def test_a_job_whose_racer_is_too_bold_fails(tmp_path, capsys):
    """No margin, all of a friction that it takes for certain, on a road that holds three quarters of it."""
    more = LAP.replace("1.5e5", "1.2e5, mu_f = 1.1, mu_r = 1.15, C_f = 1.2e5, C_r = 1.6e5")
    wrong = "laps = 1\nfriction = 0.75\nshare = 1.0\nmargin = 0.0\ngrip_std = 0.0\n"
    assert main(["lap", job(tmp_path, f"{more}[race]\n{wrong}"), "--out", str(tmp_path / "o")]) == 1
    assert "The race: poor." in capsys.readouterr().out
