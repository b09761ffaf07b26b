"""An FMU is a plant: driven as the model that was exported into it, by the names and units that it has."""

import gc
import re
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.errors import ConfigError, FormatError, ParameterError, SimulationError
from slipangle.export.fmi import export_fmu
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.optimal.terms import Values
from slipangle.workflow.drive import drive
from slipangle.workflow.settings import read_settings
from tests.workflow.test_cli import write_job

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed: pip install --group export")
pytestmark = pytest.mark.skipif(compiler() is None, reason=sentence())
CAR = sa.OnGround(sa.Bicycle(params=SOUSA_TABLE_7_2, dt=0.002, outputs=("r", "a_y")))
STEERING = {"delay": Values(delta=0.02), "lag": Values(delta=0.05)}
STEPS = 40


@pytest.fixture(scope="module", params=[2, 3])
def file(request, tmp_path_factory):
    return export_fmu(CAR, tmp_path_factory.mktemp("fmu") / "car.fmu", version=request.param)


@pytest.fixture
def car(file):
    with sa.PlantFMU(file) as made:
        yield made


def rewritten(file, folder, *changes):
    """The FMU with changes of its description."""
    path = folder / "other.fmu"
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                text = content.decode()
                for pattern, by in changes:
                    text, count = re.subn(pattern, by, text)
                    assert count
                content = text.encode()
            new.writestr(name, content)
    return path


def test_steps_are_those_of_the_model_whatever_was_before(car):
    assert car.dt == 0.002
    assert set(car.inputs) == {"delta", "v_x"}
    assert set(car.outputs) == {"r", "a_y", "X", "Y", "psi", "v_x"}
    for v_x, psi in ((20.0, 0.3), (15.0, -1.0)):
        measured = car.reset({"X": 3.0, "Y": -1.0, "psi": psi, "v_x": v_x})
        assert (measured["X"], measured["psi"], measured["v_x"]) == (3.0, psi, v_x)
        x, rng = CAR.straight(v_x, X=3.0, Y=-1.0, psi=psi), np.random.default_rng(0)
        for _ in range(STEPS):
            u = [0.03 * rng.normal(), v_x]
            measured = car.step(dict(zip(CAR.inputs, u, strict=True)))
            x = np.asarray(CAR.step(x, np.array(u)))
            expected = dict(zip(CAR.outputs, np.asarray(CAR.output(x, np.array(u))), strict=True))
            expected |= dict(zip(CAR.states, x, strict=True))
            for name in ("r", "a_y", "X", "Y", "psi"):
                assert measured[name] == pytest.approx(expected[name], rel=1e-9, abs=1e-9)


def test_a_driver_closes_the_loop_as_on_the_model(car):
    """From measurements to commands, delay and lag of the steering put around both."""
    known = sa.Delayed(
        sa.Steered(sa.Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("r",)), steering_lag=0.05),
        delays={"delta": 0.02},
        longest=0.04,
    )
    driver = sa.Driver(known, sa.double_lane_change(20.0), noise={"r": 0.002})
    seen = ("r", "v_x", "X", "Y", "psi")
    runs = [sa.drive(sa.Plant(plant, **STEERING), driver, channels=seen) for plant in (car, CAR)]
    assert runs[0].end is runs[1].end
    assert runs[0].inside
    assert runs[0].max("y") < 0.1
    assert runs[0].e_y == pytest.approx(runs[1].e_y, abs=1e-7)


def test_what_was_unpacked_goes_with_the_plant(file):
    made = sa.PlantFMU(file)
    folder = Path(made._folder)
    assert folder.is_dir()
    del made
    gc.collect()
    assert not folder.exists()


def test_names_units_and_parameters_are_the_users(file, tmp_path):
    """A car whose steering is in degrees under another name, and twice as heavy."""
    unit = r'(name="delta"[^>]*>?\s*(?:<Real )?[^>]*)unit="rad"'
    other = rewritten(file, tmp_path, (unit, r'\1unit="deg"'), ('name="delta"', 'name="hand &lt;1&gt;"'))
    heavy = 2.0 * CAR.off_ground.value("mass")
    with sa.PlantFMU(
        other, inputs={"delta": "hand <1>", "v_x": "v_x"}, outputs={"r": "r", "v_x": "v_x"}, parameters={"mass": heavy}
    ) as car:
        assert car.outputs == ("r", "v_x")
        car.reset({"X": 0.0, "Y": 0.0, "psi": 0.0, "v_x": 20.0})
        model, x = sa.OnGround(CAR.off_ground.with_values(mass=heavy)), np.array(CAR.straight(20.0))
        for _ in range(STEPS):
            measured = car.step({"delta": np.deg2rad(1.0), "v_x": 20.0})
            x = np.asarray(model.step(x, np.array([1.0, 20.0])))  # the exported equations take the number as it is
        assert measured["r"] == pytest.approx(np.asarray(model.output(x, np.array([1.0, 20.0])))[0], rel=1e-9)


def test_one_that_starts_elsewhere_or_refuses_is_an_error(car, file):
    with sa.PlantFMU(file, start={}) as fixed, pytest.raises(SimulationError, match=r"starts at X = 0, asked for 5"):
        fixed.reset({"X": 5.0, "Y": 0.0, "psi": 0.0, "v_x": 20.0})
    with sa.PlantFMU(file, dt=0.003) as between:
        between.reset({"X": 0.0, "Y": 0.0, "psi": 0.0, "v_x": 20.0})
        with pytest.raises(SimulationError, match="fails at t = 0 s"):
            between.step({"delta": 0.0, "v_x": 20.0})
    with (
        sa.PlantFMU(file, parameters={"mass": -1.0}) as wrong,
        pytest.raises(SimulationError, match="fails at t = 0 s"),
    ):
        wrong.reset({"X": 0.0, "Y": 0.0, "psi": 0.0, "v_x": 20.0})
    car.close()
    with pytest.raises(SimulationError, match="is closed"):
        car.step({"delta": 0.0, "v_x": 20.0})


def test_what_is_no_plant_is_said(file, tmp_path, monkeypatch):
    with pytest.raises(ParameterError, match=r"inputs names the variable 'steer', which 'car.fmu' does not have"):
        sa.PlantFMU(file, inputs={"delta": "steer"})
    with pytest.raises(ParameterError, match="start names"):
        sa.PlantFMU(file, start={"r": "r"})
    for wrong in ({"start": {"v_x": 20.0}}, {"inputs": ["delta"]}, {"outputs": "r"}, {"start": {1: "v_x"}}):
        with pytest.raises(ParameterError, match=r"is .*; expected the name of a variable for each channel"):
            sa.PlantFMU(file, **wrong)
    for wrong in ({"parameters": {"mass": "heavy"}}, {"parameters": [1.0]}, {"dt": "short"}):
        with pytest.raises(ParameterError, match=r"is .*; expected a number by each name"):
            sa.PlantFMU(file, **wrong)
    with pytest.raises(ParameterError, match="recommends no step size"):
        sa.PlantFMU(rewritten(file, tmp_path, (r' stepSize="[^"]*"', "")))
    (tmp_path / "no.fmu").write_bytes(b"nothing")
    with pytest.raises(FormatError, match="cannot be read as an FMU"):
        sa.PlantFMU(tmp_path / "no.fmu")
    with pytest.raises(FormatError, match="cannot be started here"):
        sa.PlantFMU(export_fmu(CAR, tmp_path / "source.fmu", binary=False))
    monkeypatch.setitem(__import__("sys").modules, "fmpy", None)
    with pytest.raises(ConfigError, match=r"driving an FMU needs fmpy, which .* 'slipangle\[fmu\]'"):
        sa.PlantFMU(file)


def test_a_job_names_an_fmu_beside_it(file, tmp_path):
    """Driven through the lane change by the path follower of the job, as the model inside is when driven in Python."""
    shutil.copy(file, tmp_path / "car.fmu")
    more = """[controller]
model = "bicycle"
kind = "pure-pursuit"
v_x = 15
[plant]
kind = "fmu"
file = "car.fmu"
"""
    settings = read_settings(write_job(tmp_path, more=more))
    model = sa.Bicycle(params=SOUSA_TABLE_7_2, dt=0.05)
    run, said, _ = drive(settings.controller, settings.plant, model, lambda share: None, None)
    assert "fmu" in said
    assert run.inside
    assert run.max("y") < 1.0
