"""Everything can be added from outside the package: one of each kind, written as another package would."""

import json
import struct
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
import pytest

from slipangle.cli import main
from slipangle.control.followers.followers import Stanley
from slipangle.control.mpc import MPC
from slipangle.data.dataset import Dataset
from slipangle.data.readers import READERS, ArrayTable, Header, read, reader
from slipangle.data.signals import SIGNALS
from slipangle.errors import FormatError, ModelWarning, ParameterError
from slipangle.estimate.ekf import EKF
from slipangle.fields import Within
from slipangle.identify.judge.validate import validate
from slipangle.identify.linear.arx import ARX
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.ode import OdeModel
from slipangle.models.parameters import ParameterSet
from slipangle.models.storage import RECORDS, load, save
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.ops import cos, stack
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime.backend import RealTime
from slipangle.optimal.terms import Limits, Values, Weights
from slipangle.report import Section, Text
from slipangle.simulate.foreign import PlantFunctions
from slipangle.simulate.manoeuvres import Manoeuvre, record
from slipangle.simulate.plant import Plant
from slipangle.units import SI
from slipangle.workflow.drive import CONTROLLERS, ESTIMATORS, PLANTS
from slipangle.workflow.kinds import FITS, KINDS
from slipangle.workflow.page import SECTIONS
from tests.workflow.test_cli import write_job


@pytest.fixture(autouse=True)
def nothing_stays(monkeypatch):
    """What a test registers is gone after it; all is compiled soon, as none of them asks how quick it is."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0")
    for registry in (KINDS, RECORDS, READERS, SIGNALS, CONTROLLERS, PLANTS, SECTIONS):
        monkeypatch.setattr(registry, "_things", dict(registry))


# ---- a model -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class YawLagParams(ParameterSet):
    gain: Annotated[float, SI("1/s", "yaw rate per steering angle", 0.1, 100)]
    lag: Annotated[float, SI("s", "time constant", 0.01, 10)]


@dataclass(frozen=True, kw_only=True)
class YawLag(OdeModel):
    """Yaw rate that follows the steering angle late, less so where it is large."""

    states = ("r",)
    inputs = ("delta",)
    params: YawLagParams

    def derivative(self, x, u):
        return stack([(self.params.gain * u[0] * cos(u[0]) - x[0]) / self.params.lag])


def yaw_record(n=400, noise=0.0):
    rng = np.random.default_rng(0)
    delta = 0.1 * np.repeat(rng.standard_normal(n // 8), 8)
    data = Dataset.from_arrays(dt=0.05, inputs={"delta": delta}, outputs={"r": np.zeros(n)})
    true = YawLag(params=YawLagParams(gain=5.0, lag=0.3), dt=0.05)
    return true, data.with_channel("r", true.simulate(data).y[:, 0] + noise * rng.standard_normal(n))


def start():
    return YawLag(params=YawLagParams(gain=2.0, lag=1.0), dt=0.05)


def test_a_model_is_simulated_judged_fitted_filtered_and_compiled(tmp_path):
    RECORDS.register("YawLag")(YawLag)
    RECORDS.register("YawLagParams")(YawLagParams)
    _, data = yaw_record(noise=1e-3)
    train, test = data.split(0.7)
    fitted = GreyBox(start=start(), free=("gain", "lag")).fit(train)
    assert [fitted.params.gain, fitted.params.lag] == pytest.approx([5.0, 0.3], rel=5e-3)
    assert validate(fitted, test).free_run_scores["r"].fit > 98
    filtered = EKF(start=start(), free=("gain", "lag"), noise_std={"r": 1e-3}, walk_std={"gain": 0.01}).fit(train)
    assert [filtered.params.gain, filtered.params.lag] == pytest.approx([5.0, 0.3], rel=0.1)
    again = load(save(fitted, tmp_path / "yaw.json"))
    assert np.array_equal(again.simulate(test).y, fitted.simulate(test).y)


@pytest.mark.parametrize("solver", ["ipopt", RealTime(iterations=0)])
def test_a_model_is_controlled(solver):
    true, _ = yaw_record()
    mpc = MPC(
        true, horizon=10, Q=Weights(r=1.0), S=Weights(delta=1e-3), limits=Limits(delta=(-0.3, 0.3)), solver=solver
    )
    plan = mpc.plan(np.zeros(1), Reference(tracked=np.full((11, 1), 0.5), exogenous=np.empty((11, 0))))
    assert plan.status.solved
    assert plan.x[-1, 0] == pytest.approx(0.5, abs=0.02)


def test_a_model_is_a_kind_of_a_job(tmp_path, capsys):
    KINDS.register("yaw lag")(YawLag)
    more = "[[model]]\nname='lag'\nkind='yaw lag'\ninputs=['delta']\ncar={ gain=4, lag=0.2 }\nfree=['gain', 'lag']\n"
    assert main(["run", str(write_job(tmp_path, more=more)), "--out", str(tmp_path / "out"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["models"]["lag"]["parameters"]
    assert found["gain"]["value"] > 0
    with pytest.raises(ParameterError, match="there is a model kind 'arx' already"):
        KINDS.register("arx")(YawLag)


# ---- an estimator --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class BestOrder:
    """The ARX order up to a largest one whose free run follows the end of its training data best."""

    largest: int = 3
    weights: tuple[float, ...] = field(default=(1.0,))

    def fit(self, data):
        early, late = data.split(0.7)
        models = [ARX(na=n, nb=n).fit(early) for n in range(1, self.largest + 1)]
        return min(models, key=lambda m: np.nanmean(m.simulate(late).error ** 2))


def test_an_estimator_is_a_kind_of_a_job(tmp_path, capsys):
    KINDS.register("best order")(BestOrder)
    more = "[[model]]\nname = 'best'\nkind = 'best order'\n"
    assert main(["run", str(write_job(tmp_path, more=more + "largest = 2")), "--out", str(tmp_path), "--json"]) == 0
    assert "best" in json.loads(capsys.readouterr().out)["models"]
    for entry, said in (("larges = 2", "largest"), ("largest = 'a'", "expected a whole number")):
        assert main(["run", str(write_job(tmp_path, more=more + entry)), "--out", str(tmp_path)]) == 2
        assert said in capsys.readouterr().err


def test_a_kind_comes_with_an_installed_package(tmp_path, monkeypatch, capsys):
    """An entry point is enough: nobody imports the package."""
    (tmp_path / "yawkit.py").write_text("from tests.test_extension import BestOrder as Order\n")
    info = tmp_path / "yawkit-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: yawkit\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[slipangle.kinds]\ninstalled = yawkit:Order\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(KINDS, "_searched", False)
    more = "[[model]]\nname = 'best'\nkind = 'installed'\n"
    assert main(["run", str(write_job(tmp_path, more=more)), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert "best" in json.loads(capsys.readouterr().out)["models"]


# ---- a log format --------------------------------------------------------------------------------------------------


def yaw_log(path):
    """Columns of a binary log: magic, count of rows, then doubles row by row."""
    raw = path.read_bytes()
    (rows,) = struct.unpack("<i", raw[4:8])
    headers = (Header(text="t", name="t", unit="s"), Header(text="yaw", name="yaw", unit="deg/s"))
    return ArrayTable(name=path.name, headers=headers, values=np.frombuffer(raw[8:]).reshape(rows, 2))


def test_a_format_is_known_by_its_content(tmp_path):
    reader("yaw log", recognises=lambda head: head.startswith(b"YAWL"))(yaw_log)
    rows = np.column_stack([0.1 * np.arange(20), 10 * np.ones(20)])
    file = tmp_path / "log.csv"
    file.write_bytes(b"YAWL" + struct.pack("<i", 20) + rows.tobytes())
    data = read(file, columns={"r": "yaw"}, outputs=["r"])
    assert data.dt == pytest.approx(0.1)
    assert data["r"] == pytest.approx(np.deg2rad(10))
    file.write_text("t,r [rad/s]\n" + "\n".join(f"{0.1 * k},1" for k in range(20)))
    assert read(file)["r"] == pytest.approx(1.0)
    with pytest.raises(FormatError, match=r"suffix '.xyz'.*\.csv"):
        read(file.rename(tmp_path / "log.xyz"))


# ---- a signal ------------------------------------------------------------------------------------------------------


def test_a_signal_drives_a_plant_and_is_listed(capsys):
    @SIGNALS.register("triangle")
    def triangle(n, dt, *, amplitude=1.0, period=1.0):
        phase = dt * np.arange(n) / period % 1.0
        return amplitude * (1 - 4 * np.abs(phase - 0.5))

    steering = SIGNALS["triangle"](201, 0.05, amplitude=0.1, period=2.0)
    true, _ = yaw_record()
    log = record(Plant(true), Manoeuvre(delta=steering, v_x=10.0, dt=0.05), x0=np.zeros(1))
    assert log["delta"] == pytest.approx(steering)
    assert np.ptp(log["r"]) > 0.3
    assert main(["list", "signals", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["signals"]
    assert listed["triangle"] == __name__
    assert listed["prbs"] == "slipangle.data.signals.excitation"


# ---- a controller --------------------------------------------------------------------------------------------------


def test_a_controller_drives_a_job_and_is_listed(tmp_path, capsys):
    @CONTROLLERS.register("weak stanley")
    def weak(model, settings, *, gain: Annotated[float, Within(0.1, 10)] = 1.0):
        return Stanley(params=model.params, gain=gain, dt=settings.dt, limit=np.deg2rad(settings.delta_max))

    job = """[controller]
model = 'bicycle'
kind = 'weak stanley'
gain = 2.0
v_x = 10.0
cars = 0
[plant]
catalogue = 'sousa-table-6.1'
"""
    path = write_job(tmp_path, more=job)
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["closed_loop"]["end"] == "FINISHED"
    assert "The controller weak stanley on" in (tmp_path / "out" / "index.html").read_text()
    assert main(["run", str(write_job(tmp_path, more=job.replace("2.0", "20.0"))), "--out", str(tmp_path)]) == 2
    assert "gain is 20.0; expected 0.1 to 10" in capsys.readouterr().err
    assert main(["list", "controllers"]) == 0
    assert "weak stanley" in capsys.readouterr().out


# ---- a vehicle -----------------------------------------------------------------------------------------------------


def test_a_vehicle_from_outside_is_driven_by_a_job(tmp_path, capsys):
    @PLANTS.register("other bicycle")
    def other(*, late: Annotated[float, Within(0, 1)] = 0.0):
        model = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.01, outputs=("v_y", "r")))
        drive = []

        def reset(start):
            drive[:] = [Plant(model, delay=Values(delta=late)).start(model.straight(**start), np.zeros(2))]
            return drive[0].true()

        def step(commands):
            drive[0].advance(np.array([commands["delta"], 10.0]), 1)
            return drive[0].true()

        names = ("X", "Y", "psi", "v_x", "v_y", "r")
        return PlantFunctions(step=step, reset=reset, dt=0.01, inputs=("delta",), outputs=names)

    job = (
        "[controller]\nmodel = 'bicycle'\nkind = 'stanley'\nv_x = 10.0\n[plant]\nkind = 'other bicycle'\nlate = 0.02\n"
    )
    path = write_job(tmp_path, more=job)
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["closed_loop"]["end"] == "FINISHED"
    assert "a vehicle from outside, “other bicycle”" in (tmp_path / "out" / "index.html").read_text()
    for bad, said in {
        job.replace("0.02", "2"): "late is 2.0; expected 0 to 1",
        job.replace("late", "later"): "no entry 'later'",
        job.replace("other b", "others b"): "kind is 'others bicycle'",
        job.replace("kind = 'other bicycle'\n", ""): "no entry 'late'",
        job + "catalogue = 'sousa-table-6.1'": "a kind and a catalogue name",
        job.replace("'other bicycle'\nlate = 0.02", "'process'\naddress = '10.0.0.1:1'"): "one of this machine",
    }.items():
        assert main(["run", str(write_job(tmp_path, more=bad)), "--out", str(tmp_path / "out")]) == 2
        assert said in capsys.readouterr().err


def test_what_can_be_listed(capsys):
    assert main(["list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert {what: set(names) for what, names in listed.items()} == {
        "models": set(KINDS),
        "controllers": set(CONTROLLERS),
        "plants": set(PLANTS),
        "estimators": set(ESTIMATORS),
        "fits": set(FITS),
        "sections": set(SECTIONS),
        "readers": set(READERS),
        "signals": set(SIGNALS),
        "records": set(RECORDS),
    }
    assert main(["list", "signal"]) == 2
    assert "there is no list of 'signal'; nearest are 'signals'" in capsys.readouterr().err


# ---- a section -----------------------------------------------------------------------------------------------------


def test_a_section_of_the_page(tmp_path):
    @SECTIONS.register("driver")
    def driver(outcome, command):
        yield Section(title="Who drove", blocks=(Text(text=f"somebody, over {outcome.data.n_samples} samples"),))

    assert main(["run", str(write_job(tmp_path)), "--out", str(tmp_path / "out")]) == 0
    assert "somebody, over 400 samples" in (tmp_path / "out" / "index.html").read_text()


# ---- a cost or limit -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["ipopt", RealTime(iterations=0)])
def test_a_term_costs_and_limits(solver):
    """Tire use, a function of state, inputs and parameters that the model knows nothing of, is limited or weighed."""
    true, _ = yaw_record()

    def effort(x, u, p):
        return p.gain * u[0] - x[0]

    def planned(**settings):
        mpc = MPC(true, horizon=5, controls=("delta",), solver=solver, terms={"effort": effort}, **settings)
        plan = mpc.plan(np.zeros(1), Reference(tracked=np.full((6, 1), 0.5), exogenous=np.empty((6, 0))))
        assert plan.status.solved
        return np.abs(5.0 * plan.u[:, 0] - plan.x[:-1, 0]).max()

    with pytest.warns(ModelWarning, match="does nothing"):
        free = planned(Q=Weights(r=1.0), S=Weights(delta=1e-3))
    assert planned(Q=Weights(r=1.0), S=Weights(delta=1e-3), limits=Limits(effort=(-0.3, 0.3))) == pytest.approx(0.3)
    assert planned(Q=Weights(r=1.0, effort=10.0), S=Weights(delta=1e-3)) < 0.5 * free
    with pytest.raises(ParameterError, match=r"terms name \['r'\]"):
        MPC(true, horizon=5, Q=Weights(r=1.0), controls=("delta",), terms={"r": effort})
