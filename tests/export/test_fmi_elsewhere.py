"""FMUs in other importers: libcosim, on Modelon's FMI Library (FMI 2.0), and Ecos, on fmi4c (FMI 2.0 and 3.0)."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.export.fmi import export_fmu
from tests.export.test_mpc import controller
from tests.export.tools import needs
from tests.models.all_models import ALL_MODELS


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0")
    needs()


class Ecos:
    """An instance in Ecos, its variables by name."""

    def __init__(self, path, dt, **start):
        try:
            import ecospy
        except (ImportError, OSError) as error:
            pytest.skip(f"{error}: pip install --group export, apt-get install libtbb12")
        self.structure = ecospy.EcosSimulationStructure()
        self.structure.add_model("it", str(path))
        self.simulation = ecospy.EcosSimulation(structure=self.structure, step_size=dt)
        self.set(**start)
        self.simulation.init()

    def set(self, **values):
        for name, value in values.items():
            self.simulation.set_real(f"it::{name}", float(value))

    def get(self, *names):
        return np.array([self.simulation.get_real(f"it::{n}") for n in names])

    def step(self):
        self.simulation.step(1)

    def end(self):
        self.simulation.terminate()
        self.simulation.free()
        self.structure.free()


class Cosim:
    """An instance in libcosim, its variables by name; what is set counts from the next step on."""

    def __init__(self, path, dt, **start):
        reason = "libcosimpy is not installed: pip install --group export"
        execution = pytest.importorskip("libcosimpy.CosimExecution", reason=reason).CosimExecution
        from libcosimpy.CosimManipulator import CosimManipulator
        from libcosimpy.CosimObserver import CosimObserver
        from libcosimpy.CosimSlave import CosimLocalSlave

        self.run = execution.from_step_size(step_size=round(dt * 1e9))
        self.it = self.run.add_local_slave(local_slave=CosimLocalSlave(fmu_path=str(path), instance_name="it"))
        self.at = {v.name.decode(): v.reference for v in self.run.slave_variables(self.it)}
        self.hand, self.eye = CosimManipulator.create_override(), CosimObserver.create_last_value()
        self.run.add_manipulator(manipulator=self.hand)
        self.run.add_observer(observer=self.eye)
        for name, value in start.items():
            assert self.run.real_initial_value(
                slave_index=self.it, variable_reference=self.at[name], value=float(value)
            )

    def set(self, **values):
        at, to = [self.at[n] for n in values], [float(v) for v in values.values()]
        assert self.hand.slave_real_values(slave_index=self.it, variable_references=at, values=to)

    def get(self, *names):
        return np.array(self.eye.last_real_values(slave_index=self.it, variable_references=[self.at[n] for n in names]))

    def step(self):
        assert self.run.step()

    def end(self):
        """Nothing is left to be done."""


EACH = pytest.mark.parametrize(("importer", "version"), [(Ecos, 2), (Ecos, 3), (Cosim, 2)])


@EACH
@pytest.mark.parametrize("name", ["bicycle, three outputs", "NARX"])
def test_a_model_runs_as_inside(name, importer, version, tmp_path):
    model, rng = ALL_MODELS[name], np.random.default_rng(2)
    x = np.array(model.straight(20.0))
    start = {f"state.{n}": v for n, v in zip(model.states, x, strict=True)}
    one = importer(export_fmu(model, tmp_path / "model.fmu", version=version), model.dt, **start)
    step, output, _ = model.functions
    for _ in range(60):
        u = np.array([20.0 if n == "v_x" else 0.02 * rng.normal() for n in model.inputs])
        one.set(**dict(zip(model.inputs, u, strict=True)))
        one.step()
        x = np.asarray(step(x, u)).ravel()
        assert one.get(*(f"state.{n}" for n in model.states)) == pytest.approx(x, rel=1e-9, abs=1e-9)
        assert one.get(*model.outputs) == pytest.approx(np.asarray(output(x, u)).ravel(), rel=1e-9, abs=1e-9)
    assert np.abs(x).max() > 1e-3
    one.end()


@pytest.mark.slow
@EACH
def test_controller_and_plant_close_the_loop(importer, version, tmp_path):
    """A lane change by two FMUs, as by MPC and model in Python."""
    mpc = controller(6)
    model, path = mpc.model, sa.double_lane_change(20.0)
    pilot, plant = (
        importer(export_fmu(t, tmp_path / f"{n}.fmu", version=version), t.dt)
        for n, t in (("mpc", mpc), ("plant", model))
    )
    x, s, plan = np.array(model.straight(20.0)), 0.0, None
    for _ in range(60):
        reference = mpc.reference(path.ahead(s, mpc.times))
        given = {f"state.{n}": v for n, v in zip(model.states, x, strict=True)}
        for what, names, rows in (
            ("reference", mpc.references, reference.tracked),
            ("exogenous", mpc.exogenous, reference.exogenous),
        ):
            given |= {f"{what}.{n}[{i}]": row[j] for i, row in enumerate(rows) for j, n in enumerate(names)}
        pilot.set(**given)
        pilot.step()
        plan = mpc.plan(x, reference, plan)
        delta, age = pilot.get("delta", "age")
        assert (delta, age) == pytest.approx((plan.command[0], 0.0), rel=1e-9, abs=1e-12)
        plant.set(delta=delta, v_x=20.0)
        plant.step()
        x = plant.get(*(f"state.{n}" for n in model.states))
        s += 1.0
    assert abs(x[3]) > 1.0
    pilot.end()
    plant.end()
