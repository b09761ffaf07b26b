"""Tire files in jobs: identified, controlled and driven, found beside the job."""

import json
from functools import cache

import numpy as np
import pytest

from slipangle.cli import main
from slipangle.data.dataset import Dataset
from slipangle.errors import ConfigError
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.vehicles.bicycle import Bicycle, BicycleParams
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE
from slipangle.models.vehicles.tire_bicycle import TireBicycle, TireBicycleParams
from slipangle.workflow.drive import ControllerSettings, PlantSettings, build_plant
from slipangle.workflow.kinds import KINDS
from slipangle.workflow.robustness import equivalent, trial_of
from slipangle.workflow.settings import read_settings

CAR = TireBicycleParams(mass=1200.0, inertia_z=1500.0, wheelbase=2.6, l_f=1.2, LMUY_f=0.8, LKY_f=0.9)
STIFF = BicycleParams(mass=1200.0, inertia_z=1500.0, wheelbase=2.6, l_f=1.2, C_f=8e4, C_r=9e4)
JOB = """
title = "test job"
[data]
file = "log.csv"
inputs = ["delta", "v_x"]
outputs = ["r"]
dt = 0.05
[[model]]
name = "car"
kind = "tire-bicycle"
tire = "tires/a.tir"
free = ["LMUY_f", "LKY_f"]
car = {{ mass = 1200, wheelbase = 2.6, l_f = 1.2, inertia_z = 1500 }}
{more}
"""


@cache
def log():
    t = 0.05 * np.arange(400)
    inputs = {"delta": (0.02 + 0.004 * t) * np.sin(1.2 * t), "v_x": 22 + np.sin(t / 5)}
    run = identified().simulate(Dataset.from_arrays(inputs, {"r": 0 * t}, 0.05))
    columns = np.column_stack([*inputs.values(), run.channel("r")])
    return [",".join(f"{v:.9g}" for v in row) for row in columns]


def write(folder, more="", **change):
    (folder / "log.csv").write_text("\n".join(["delta,v_x,r", *log()]) + "\n", encoding="utf-8")
    (folder / "tires").mkdir(exist_ok=True)
    PASSENGER_TIRE.write_tir(folder / "tires" / "a.tir")
    text = JOB.format(more=more)
    for old, new in change.items():
        text = text.replace(old, new)
    (folder / "job.toml").write_text(text, encoding="utf-8")
    return folder / "job.toml"


def test_scaling_factors_from_a_job(tmp_path, monkeypatch, capsys):
    job = write(tmp_path)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)  # files are found from the job
    assert main(["identify", str(job), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    found = {name: known["value"] for name, known in told["car"]["parameters"].items()}
    assert found["LMUY_f"] == pytest.approx(0.8, abs=1e-3)
    assert found["LKY_f"] == pytest.approx(0.9, abs=1e-3)


def settings(tmp_path, more=""):
    return read_settings(write(tmp_path, more=more))


def identified():
    return TireBicycle(params=CAR, dt=0.05, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE)


def test_the_plant_is_on_the_tires(tmp_path):
    wanted = settings(tmp_path, "[plant]\ntire = 'tires/a.tir'\nfriction = 0.7\ncar = { height = 0.6 }").plant
    plant, driver, said = build_plant(wanted, identified())
    car = plant.model
    assert isinstance(car.tire_f, MagicFormulaTire)
    assert car.tire_f.coefficients == PASSENGER_TIRE.coefficients
    assert car.road.friction == (0.7,) * 4
    assert (car.params.mass, car.params.height, car.params.radius) == (1200.0, 0.6, 0.344)
    assert 0.4 < car.params.relaxation_y < 0.7  # of the file: 1e5 N/rad over 1.6e5 N/m
    assert driver is not None
    assert "on tires of a.tir on a road of 0.7 times their friction (rolling radius 0.344 m" in said
    bicycle, friction = equivalent(wanted, CAR, (car.tire_f, car.tire_r))
    assert bicycle.mass == 1200.0
    assert friction == pytest.approx(0.7 * 1.06, rel=0.05)


def test_without_a_file_the_plant_has_the_identified_tires():
    plant, _, said = build_plant(PlantSettings(), identified())
    assert plant.model.tire_f.coefficients.LMUY == pytest.approx(0.8)
    assert "on tires as identified" in said


@pytest.mark.parametrize(
    ("plant", "said"),
    [
        ("catalogue = 'sousa-table-6.1'\nfriction = 0.3", "has friction, which changes nothing of a car of the cat"),
        ("catalogue = 'sousa-table-6.1'\ncar = { height = 0.6 }", "has car, which changes nothing of a car of the cat"),
        ("car = { height = 0.6 }", "has car, which changes nothing of a car made of the identified bicycle"),
        (
            "kind = 'process'\naddress = '127.0.0.1:1'\nfriction = 0.3",
            "car from outside.*leave kind out",
        ),
    ],
)
def test_what_a_plant_does_not_heed_is_refused(plant, said, tmp_path):
    """Such as a wet road for a car of the catalogue, which drove on as on a dry one."""
    wanted, model = settings(tmp_path, f"[plant]\n{plant}").plant, Bicycle(params=STIFF, dt=0.05)
    with pytest.raises(ConfigError, match=said):
        build_plant(wanted, model)
    if not wanted.kind:
        with pytest.raises(ConfigError, match=said):
            trial_of(ControllerSettings(model="car"), wanted, model, None)


def test_friction_is_of_the_identified_bicycle(tmp_path):
    plant, _, said = build_plant(settings(tmp_path, "[plant]\nfriction = 0.7").plant, Bicycle(params=STIFF, dt=0.05))
    assert plant.model.tire_f.lateral.D == 0.7
    assert "0.7" in said


def test_the_catalogue_car_on_other_tires(tmp_path):
    wanted = settings(tmp_path, "[plant]\ncatalogue = 'sousa-table-6.1'\ntire = 'tires/a.tir'").plant
    plant, _, _ = build_plant(wanted, identified())
    assert plant.model.params.mass == 2500.0


@pytest.mark.parametrize(
    ("change", "more", "said"),
    [
        ({"tires/a.tir": "b.tir"}, "", "model 'car': tire is 'b.tir', and there is no such file"),
        ({'tire = "tires/a.tir"\n': ""}, "", "tire is '', tire_f '', tire_r ''; expected tire, or both"),
        ({}, "[plant]\ntire = 'b.tir'", "[plant]: tire is 'b.tir', and there is no such file"),
        ({}, "[plant]\ntire_f = 'tires/a.tir'", "expected tire, or both tire_f and tire_r"),
        ({}, "[plant]\nkind = 'process'\naddress = '127.0.0.1:9'\ntire = 'tires/a.tir'", "has a kind and a tire"),
        ({"mass = 1200": "mas = 1200"}, "", "no parameter 'mas'; nearest"),
        ({"mass = 1200, ": ""}, "", "car lacks mass"),
    ],
)
def test_mistakes(change, more, said, tmp_path, capsys):
    assert main(["identify", str(write(tmp_path, more=more, **change))]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert "Traceback" not in told


def test_the_kind_is_listed():
    assert "tire-bicycle" in KINDS
