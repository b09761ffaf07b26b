"""FMUs: valid, and the same numbers as the simulation inside, alone and closed through an importer."""

import re
import zipfile

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.errors import ParameterError, WriteError
from slipangle.export.drivers import channels
from slipangle.export.fmi import export_fmu
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.paths.lane_change import double_lane_change
from tests.export.loaded import STATUSES
from tests.export.test_drivers import LAGGED, LATE, PEDALS, driver
from tests.export.test_mpc import STANLEY, controller
from tests.export.tools import STRICT, needs, run
from tests.models.all_models import ALL_MODELS

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed: pip install --group export")
pytestmark = [
    pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence()),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0")


class Slave:
    """An instance in fmpy, its variables by name, of FMI 2.0 or 3.0."""

    def __init__(self, path, folder, **start):
        self.description = fmpy.read_model_description(str(path))
        self.at = {v.name: v.valueReference for v in self.description.modelVariables}
        self.dt = float(self.description.defaultExperiment.stepSize)
        self.newer = self.description.fmiVersion == "3.0"
        self.fmu = (fmpy.fmi3.FMU3Slave if self.newer else fmpy.fmi2.FMU2Slave)(
            guid=self.description.guid,
            unzipDirectory=fmpy.extract(str(path), unzipdir=str(folder)),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="one",
        )
        self.fmu.instantiate()
        if not self.newer:
            self.fmu.setupExperiment(startTime=0.0)
        self.set(**start)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.time = 0.0

    def set(self, **values):
        put = self.fmu.setFloat64 if self.newer else self.fmu.setReal
        put([self.at[n] for n in values], [float(v) for v in values.values()])

    def get(self, *names):
        take = self.fmu.getFloat64 if self.newer else self.fmu.getReal
        return np.array(take([self.at[n] for n in names]))

    def slope(self, of, **along):
        return self.fmu.getDirectionalDerivative(
            [self.at[n] for n in of], [self.at[n] for n in along], [float(v) for v in along.values()]
        )

    def step(self, steps=1):
        self.fmu.doStep(self.time, steps * self.dt)
        self.time += steps * self.dt

    def end(self):
        self.fmu.terminate()
        self.fmu.freeInstance()


BOTH = pytest.mark.parametrize("version", [2, 3])
LONG = [pytest.param(n, marks=pytest.mark.slow) for n in ("single track, Radau", "dual track, front drive")]


@BOTH
@pytest.mark.parametrize("name", ["bicycle, three outputs", "NARX", *LONG])
def test_a_model_runs_as_inside(name, version, tmp_path):
    import fmpy.validation

    model, rng = ALL_MODELS[name], np.random.default_rng(2)
    path = export_fmu(model, tmp_path / "model.fmu", version=version)
    assert fmpy.validation.validate_fmu(str(path)) == []
    x = np.array(model.straight(20.0))
    slave = Slave(path, tmp_path / "at", **{f"state.{n}": v for n, v in zip(model.states, x, strict=True)})
    step, output, _ = model.functions
    for _ in range(60):
        u = np.array([20.0 if n == "v_x" else 0.02 * rng.normal() for n in model.inputs])
        slave.set(**dict(zip(model.inputs, u, strict=True)))
        assert slave.get(*model.outputs) == pytest.approx(np.asarray(output(x, u)).ravel(), rel=1e-9, abs=1e-9)
        slave.step()
        x = np.asarray(step(x, u)).ravel()
    assert slave.get(*(f"state.{n}" for n in model.states)) == pytest.approx(x, rel=1e-9, abs=1e-9)
    slave.end()


def test_units_and_start_values(tmp_path):
    path = export_fmu(ALL_MODELS["bicycle, three outputs"], tmp_path / "car.fmu", name="racer")
    described = fmpy.read_model_description(str(path))
    by_name = {v.name: v for v in described.modelVariables}
    assert (by_name["v_x"].unit, by_name["a_y"].unit, by_name["delta"].causality) == ("m/s", "m/s2", "input")
    assert (by_name["v_x"].start, described.coSimulation.modelIdentifier) == ("20.0", "racer")
    results = fmpy.simulate_fmu(
        str(path), stop_time=1.0, start_values={"delta": 0.02}, output=["r"], output_interval=0.02
    )
    free = ALL_MODELS["bicycle, three outputs"]
    x = np.zeros(2)
    for _ in range(50):
        x = np.asarray(free.step(x, np.array([0.02, 20.0])))
    assert results["r"][-1] == pytest.approx(free.output(x, np.array([0.02, 20.0]))[1], rel=1e-9)


@BOTH
def test_state_is_saved_restored_and_written_out(version, tmp_path):
    model = ALL_MODELS["bicycle, three outputs"]
    path = export_fmu(model, tmp_path / "model.fmu", version=version)
    slave = Slave(path, tmp_path / "at", **{"state.v_y": 0.1})
    slave.set(delta=0.03)
    slave.step(5)
    saved, here = slave.fmu.getFMUState(), slave.get(*model.outputs)
    kept = slave.fmu.serializeFMUState(saved)
    slave.step(3)
    later = slave.get(*model.outputs)
    assert not np.allclose(here, later, rtol=1e-6)
    slave.fmu.setFMUState(saved)
    assert np.array_equal(slave.get(*model.outputs), here)
    slave.step(3)
    assert np.array_equal(slave.get(*model.outputs), later)
    slave.fmu.setFMUState(slave.fmu.deserializeFMUState(kept))
    assert np.array_equal(slave.get(*model.outputs), here)
    slave.fmu.freeFMUState(saved)
    slave.end()


def test_a_step_between_samples_is_refused(tmp_path):
    slave = Slave(export_fmu(ALL_MODELS["bicycle"], tmp_path / "model.fmu"), tmp_path / "at")
    with pytest.raises(Exception, match="fmi2DoStep failed with status 3"):
        slave.fmu.doStep(0.0, 0.5 * slave.dt)
    slave.end()


@BOTH
def test_parameters_are_tuned_within_their_ranges(version, tmp_path):
    """A step with a parameter set is that of the model with it; what no car has is refused."""
    model = ALL_MODELS["bicycle on the ground"]
    path = export_fmu(model, tmp_path / "model.fmu", version=version)
    named = {v.name: v for v in fmpy.read_model_description(str(path)).modelVariables}
    own = model.off_ground
    for name in own.parameter_names:
        said = named[name]
        assert (said.causality, said.variability, float(said.start)) == ("parameter", "tunable", own.value(name))
    assert (named["C_f"].unit, named["mass"].unit) == ("N/rad", "kg")
    slave, u = Slave(path, tmp_path / "at", C_f=0.5 * own.value("C_f")), np.array([0.02, 20.0])
    slave.set(**dict(zip(model.inputs, u, strict=True)))
    x = np.array(model.straight(20.0))
    for mass in (own.value("mass"), 1.3 * own.value("mass")):
        slave.set(mass=mass)
        varied = sa.OnGround(own.with_values(C_f=0.5 * own.value("C_f"), mass=mass))
        for _ in range(20):
            slave.step()
            x = np.asarray(varied.step(x, u))
        assert slave.get(*(f"state.{n}" for n in model.states)) == pytest.approx(x, rel=1e-9, abs=1e-9)
        assert slave.get(*model.outputs) == pytest.approx(np.asarray(varied.output(x, u)), rel=1e-9, abs=1e-9)
    assert abs(x[1]) > 0.01
    with pytest.raises(Exception, match="failed with status 3"):
        slave.set(mass=-1.0)
    assert slave.get("mass")[0] == 1.3 * own.value("mass")
    slave.end()


@BOTH
@pytest.mark.parametrize("name", ["saturating bicycle", "NARX, MIMO, delay"])
def test_directional_derivatives_are_those_of_finite_differences(name, version, tmp_path):
    model, rng = ALL_MODELS[name], np.random.default_rng(3)
    slave = Slave(export_fmu(model, tmp_path / "model.fmu", version=version), tmp_path / "at")
    known = [v.name for v in slave.description.modelVariables if v.causality in ("local", "input", "parameter")]
    starts = slave.get(*known) + np.array([0.01 * rng.normal() * (n.startswith("state")) for n in known])
    least = {v.name: float(v.min) for v in slave.description.modelVariables if v.causality == "parameter" and v.min}
    starts = np.maximum(starts, [least.get(n, -np.inf) + 0.01 for n in known])  # none at its bound, to move both ways
    slave.set(**dict(zip(known, starts, strict=True)))
    for _ in range(4):
        along = rng.normal(size=len(known)) * 1e-2 * np.maximum(np.abs(starts), 1e-2)
        told = slave.slope(model.outputs, **dict(zip(known, along, strict=True)))
        ends = []
        for sign in (1.0, -1.0):
            slave.set(**dict(zip(known, starts + sign * 1e-4 * along, strict=True)))
            ends.append(slave.get(*model.outputs))
        slave.set(**dict(zip(known, starts, strict=True)))
        assert told == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=1e-5, abs=1e-8)
        assert np.abs(told).max() > 1e-6
    with pytest.raises(Exception, match="failed with status 3"):
        slave.slope([known[0]], **{known[0]: 1.0})
    slave.end()


def test_versions_and_things_without_an_fmu_are_said(tmp_path):
    with pytest.raises(ParameterError, match="the version of FMI is 1; expected 2 or 3"):
        export_fmu(ALL_MODELS["bicycle"], tmp_path / "a.fmu", version=1)
    observer = sa.EKF(start=ALL_MODELS["bicycle"], noise_std={"r": 0.01})
    with pytest.raises(ParameterError, match="a EKF has no FMU; expected a model, a controller or a driver"):
        export_fmu(observer, tmp_path / "a.fmu")


@pytest.mark.slow
@BOTH
def test_controller_and_plant_close_the_loop(version, tmp_path):
    """Two FMUs, which know nothing of Python, drive as MPC and model do in Python."""
    import fmpy.validation

    mpc = controller(6)
    model, path = mpc.model, sa.double_lane_change(20.0)
    files = [export_fmu(t, tmp_path / f"{n}.fmu", version=version) for n, t in (("mpc", mpc), ("plant", model))]
    assert [fmpy.validation.validate_fmu(str(f)) for f in files] == [[], []]
    driver, plant = (Slave(f, tmp_path / f.stem) for f in files)
    x, s, plan = model.straight(20.0), 0.0, None
    for _ in range(60):
        reference = mpc.reference(path.ahead(s, mpc.times))
        given = {
            f"state.{n}": v for n, v in zip(model.states, plant.get(*(f"state.{n}" for n in model.states)), strict=True)
        }
        for what, names, rows in (
            ("reference", mpc.references, reference.tracked),
            ("exogenous", mpc.exogenous, reference.exogenous),
        ):
            given |= {f"{what}.{n}[{i}]": row[j] for i, row in enumerate(rows) for j, n in enumerate(names)}
        driver.set(**given)
        driver.step()
        plant.set(delta=driver.get("delta")[0], v_x=20.0)
        plant.step()
        plan = mpc.plan(x, reference, plan)
        assert driver.get("delta", "age") == pytest.approx([plan.command[0], 0.0], rel=1e-9, abs=1e-12)
        x = np.asarray(model.step(x, np.array([plan.command[0], 20.0])))
        s += 1.0
    assert plant.get(*(f"state.{n}" for n in model.states)) == pytest.approx(x, rel=1e-9, abs=1e-9)
    assert abs(x[3]) > 1.0
    driver.end()
    plant.end()


@BOTH
def test_a_driver_and_a_plant_close_the_loop(version, tmp_path):
    """The driver is told what the plant's outputs are, late and seldom the pose, and wants what it does in Python."""
    import fmpy.validation

    whole = driver(double_lane_change(20.0), LAGGED, horizon=6, late=LATE, speed=PEDALS)
    model, names = whole.controller.model, channels(whole)
    plant = sa.OnGround(sa.Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("r",)))
    files = [export_fmu(t, tmp_path / f"{n}.fmu", version=version) for n, t in (("driver", whole), ("plant", plant))]
    assert [fmpy.validation.validate_fmu(str(f)) for f in files] == [[], []]
    pilot, car = (Slave(f, tmp_path / f.stem) for f in files)
    described = {v.name: v for v in pilot.description.modelVariables}
    assert (described["measured.r"].unit, described["delta"].causality) == ("rad/s", "output")
    seen, past = set(), []
    for k in range(180):
        now = dict(zip(plant.states, car.get(*(f"state.{n}" for n in plant.states)), strict=True))
        past.append(now)
        told = {} if k < 2 else {"v_x": 20.0 + 0.01 * (k % 3), "r": now["r"]}
        if k % 10 == 5:
            told |= {n: past[-6][n] for n in ("X", "Y", "psi")}
        if k == 100:
            told = dict.fromkeys(names, np.nan)
        pilot.set(**{f"measured.{n}": v for n, v in told.items()})
        pilot.step()
        said = whole.step(told, 0.02 * k)
        wanted = [*said.values.values(), said.wanted_v_x, said.s, said.e_y, *said.state, *said.state_std]
        outputs = [v.name for v in pilot.description.modelVariables if v.causality == "output"]
        assert pilot.get(*outputs[: len(wanted)]) == pytest.approx(wanted, rel=1e-9, abs=1e-9), k
        reason, planned, status, age, restarts = pilot.get("reason", "planned", "status", "age", "restarts")
        assert (bool(planned), restarts) == (said.plan is not None, said.restarts)
        if said.plan is not None:
            assert (STATUSES[int(status)], age) == (said.plan.status, said.plan.age)
        seen.add(int(reason))
        if k == 90:
            saved = pilot.fmu.getFMUState()
            pilot.set(**{"measured.Y": 1.0})
            pilot.step()
            pilot.fmu.setFMUState(saved)
            pilot.fmu.freeFMUState(saved)
            pilot.time -= pilot.dt
        car.set(delta=pilot.get("delta")[0], v_x=20.0)
        car.step()
    assert seen == {0, 1, 3}
    assert abs(now["Y"]) > 1.0
    assert len(model.states) > len(plant.states)
    pilot.end()
    car.end()


@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
def test_compilers_have_nothing_to_say(compiler_, tmp_path):
    needs(compiler_)
    for name, version, thing in (
        ("model", 2, ALL_MODELS["bicycle"]),
        ("mpc", 2, controller(3)),
        ("newer", 3, ALL_MODELS["NARX"]),
        ("newest", 3, STANLEY),
        ("pilot", 2, driver(double_lane_change(20.0), horizon=4, speed=PEDALS)),
        ("later", 3, driver(double_lane_change(20.0), horizon=4)),
    ):
        path = export_fmu(thing, tmp_path / f"{name}.fmu", name=name, version=version, binary=False)
        with zipfile.ZipFile(path) as archive:
            assert not [n for n in archive.namelist() if n.startswith("binaries")]
            sources = [n for n in archive.namelist() if n.startswith("sources/") and n.endswith((".c", ".h"))]
            for source in sources:
                (tmp_path / source.rpartition("/")[2]).write_bytes(archive.read(source))
        for source in sources:
            if source.endswith(".c"):
                run(compiler_, *STRICT, "-fsyntax-only", source.rpartition("/")[2], folder=tmp_path)


def test_a_file_is_new_or_asked_for(tmp_path):
    path = export_fmu(ALL_MODELS["bicycle"], tmp_path / "model.fmu", binary=False)
    with pytest.raises(WriteError, match="is there already"):
        export_fmu(ALL_MODELS["bicycle"], path, binary=False)
    export_fmu(ALL_MODELS["bicycle"], path, binary=False, force=True)
    with pytest.raises(ParameterError, match="expected a lower-case identifier"):
        export_fmu(ALL_MODELS["bicycle"], tmp_path / "b.fmu", name="../x")
    with zipfile.ZipFile(path) as archive:
        assert re.search(r"state\.v_y", archive.read("modelDescription.xml").decode())
