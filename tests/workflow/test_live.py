"""What a job's page shows of its closed loop: tire forces, a second controller, the loop to drive oneself."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.export.live import Live
from slipangle.simulate.loop import closed_loop
from slipangle.workflow.controllers import ControllerSettings, build_mpc, build_path
from slipangle.workflow.drive import PlantSettings, build_plant
from slipangle.workflow.live import _slider, live_drive, other_law, tire_use

PARAMS = sa.BicycleParams(mass=1500, inertia_z=2500, wheelbase=2.7, l_f=1.2, C_f=9e4, C_r=1.1e5)
MODEL = sa.Bicycle(params=PARAMS, dt=0.05, outputs=("v_y", "r"))
WANTED = ControllerSettings(model="car", v_x=15.0)
PLANT = PlantSettings()


@pytest.fixture(scope="module")
def loop():
    plant, driver, _ = build_plant(PLANT, MODEL)
    mpc = build_mpc(MODEL, WANTED)
    return Live(plant=plant, mpc=mpc, path=build_path(WANTED), driver=driver)


def test_sliders_are_in_units_of_people_and_the_program_gets_its_own(loop):
    made = {s.name: (s, _slider(s, loop)) for s in loop.settings}
    for setting, slider in made.values():
        assert slider.scale * slider.value == pytest.approx(setting.value)
        assert slider.scale * slider.low == pytest.approx(setting.low)
    assert (made["pace"][1].value, made["pace"][1].unit) == (pytest.approx(54.0), "km/h")
    assert (made["mass"][1].value, made["mass"][1].unit) == (pytest.approx(1500.0), "kg")
    assert made["delay"][1].high == pytest.approx(300.0)
    assert made["weight Y"][1].ratio
    assert made["weight delta"][1].label == "weight of changes of the steering"


def test_the_tires_of_a_lane_change_are_not_used_up(loop):
    run = closed_loop(**loop.loop())
    used = np.array(tire_use(run, np.arange(len(run.t)), PLANT, MODEL))
    a_y = np.gradient(run["v_y"], run.t) + run["v_x"] * run["r"]
    assert used.shape == (len(run.t), 4)
    assert np.hypot(used[:, 1], used[:, 0]).max() <= 1
    assert 0.5 * (used[:, 1] + used[:, 3]) == pytest.approx(a_y / 9.81, abs=0.05)  # of a friction of 1, at both axles


def test_the_law_beside_drives_the_same_manoeuvre():
    beside = other_law(WANTED, PLANT, MODEL)
    assert beside.label == "feed-forward and feedback"
    assert beside.X[-1] > 140
    assert max(beside.Y) == pytest.approx(3.6, abs=0.5)
    arx = sa.ARX(na=1, nb=1)
    assert other_law(WANTED, PLANT, arx) is None


def test_where_no_program_can_be_there_is_none(loop, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_LIVE", "none")
    assert live_drive(WANTED, PLANT, MODEL, loop.mpc) is None
    monkeypatch.delenv("SLIPANGLE_LIVE")
    assert live_drive(WANTED, PLANT, MODEL, "another controller") is None
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    assert live_drive(WANTED, PLANT, MODEL, loop.mpc) is None
