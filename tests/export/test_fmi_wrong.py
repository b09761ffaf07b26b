"""FMUs in the hands of an importer that asks what it should not: said, and nothing half done."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.errors import WriteError
from slipangle.export.drives import standard_drive
from slipangle.export.fmi import export_fmu
from slipangle.paths.lane_change import double_lane_change
from tests.export import test_fmi
from tests.export.test_drivers import driver
from tests.export.test_fmi import BOTH, Slave
from tests.export.test_mpc import STANLEY
from tests.models.all_models import ALL_MODELS

pytestmark, quick = test_fmi.pytestmark, test_fmi.quick


@BOTH
def test_what_is_no_number_is_said_and_not_kept(version, tmp_path):
    """An input that is NaN makes no step, of which nothing is left: the next one is as if it had not been."""
    model = ALL_MODELS["bicycle, three outputs"]
    slave = Slave(export_fmu(model, tmp_path / "model.fmu", version=version), tmp_path / "at", **{"state.v_y": 0.1})
    slave.set(delta=np.nan)
    with pytest.raises(Exception, match="DoStep failed with status 3"):
        slave.step(3)
    slave.set(delta=0.03)
    slave.step(3)
    x = np.array([0.1, 0.0])
    for _ in range(3):
        x = np.asarray(model.step(x, np.array([0.03, 20.0])))
    assert slave.get("state.v_y", "state.r") == pytest.approx(x, rel=1e-9)
    slave.end()


@BOTH
def test_what_is_set_is_set_whole_and_time_goes_on(version, tmp_path, capfd):
    model = ALL_MODELS["bicycle on the ground"]
    slave = Slave(export_fmu(model, tmp_path / "model.fmu", version=version), tmp_path / "at")
    was = slave.get("C_f", "mass")
    with pytest.raises(Exception, match="failed with status 3"):
        slave.set(C_f=1.1 * was[0], mass=-1.0)
    assert np.array_equal(slave.get("C_f", "mass"), was)
    said = f"the parameter of value reference {slave.at['mass']} is -1; expected"
    slave.step(2)
    slave.time += 5 * slave.dt
    slave.step()
    out = "".join(capfd.readouterr())
    assert said in out
    assert f"the step begins at {7 * slave.dt:g} s, the FMU was at {2 * slave.dt:g} s" in out
    slave.end()


@BOTH
def test_parameters_that_do_not_go_together_are_said(version, tmp_path, capfd):
    """As in Python: with the step that follows, when all are set that belong together, and once."""
    model = ALL_MODELS["bicycle, three outputs"]
    slave = Slave(export_fmu(model, tmp_path / "model.fmu", version=version), tmp_path / "at")
    l_f, wheelbase, mass = slave.get("l_f", "wheelbase", "mass")
    for values, said in (
        ({}, ""),
        ({"l_f": wheelbase}, "l_f is not below the wheelbase"),
        ({}, ""),
        ({"wheelbase": 1.5 * wheelbase}, ""),
        ({"wheelbase": wheelbase, "l_f": l_f}, ""),
        ({"mass": 1e-3 * mass}, "so little mass"),
        ({"mass": 9e4, "wheelbase": 1.5, "l_f": 0.7}, "so much mass"),
        ({"mass": mass, "C_f": 1e3}, ""),
    ):
        for name, value in values.items():
            slave.set(**{name: value})
        slave.step(2)
        out = "".join(capfd.readouterr())
        assert out.count("wheelbase") == bool(said), (values, out)
        assert said in out
    slave.end()


def test_a_file_that_importers_would_not_know_is_refused(tmp_path):
    model = ALL_MODELS["bicycle, three outputs"]
    for name in ("m2", "m2.zip", "car.v2", "fmu"):
        with pytest.raises(WriteError, match=rf"{name}' does not end in .fmu; .*: say '.*{name}.fmu'$"):
            export_fmu(model, tmp_path / name, binary=False)
    assert list(tmp_path.iterdir()) == []
    assert export_fmu(model, tmp_path / "M2.FMU", binary=False).exists()


def test_the_state_of_another_fmu_is_refused(tmp_path):
    """Two models of one size, whose states would fit into each other."""
    light = ALL_MODELS["bicycle, three outputs"]
    one, other = (
        Slave(export_fmu(m, tmp_path / f"{n}.fmu"), tmp_path / n)
        for n, m in (("light", light), ("heavy", light.with_values(mass=2.0 * light.value("mass"))))
    )
    state = one.fmu.getFMUState()
    kept = one.fmu.serializeFMUState(state)
    one.step(4)
    again = one.fmu.deserializeFMUState(kept)
    assert one.fmu.serializeFMUState(again) == kept
    with pytest.raises(Exception, match="failed with status 3"):
        other.fmu.deserializeFMUState(kept)
    for fmu, *states in ((one, state, again), (other,)):
        for each in states:
            fmu.fmu.freeFMUState(each)
        fmu.end()


def piloted():
    return driver(double_lane_change(20.0), horizon=3)


@pytest.mark.parametrize(
    ("made", "name"), [(lambda: STANLEY, "status"), pytest.param(piloted, "reason", marks=pytest.mark.slow)]
)
def test_nothing_is_said_to_be_planned_before_a_step(made, name, tmp_path):
    """A status of 0 would be an optimum, a reason of 0 a plan."""
    slave = Slave(export_fmu(made(), tmp_path / "it.fmu"), tmp_path / "at")
    said = {v.name: v.description for v in slave.description.modelVariables}[name]
    assert said.rpartition("; ")[2].startswith("-1: ")
    assert slave.get(name)[0] == -1
    slave.step()
    assert slave.get(name)[0] >= 0
    slave.end()


def test_a_command_that_was_not_applied_is_told(tmp_path):
    """Rates count from what was applied; without it, as its start value says, from the command before."""
    far = 1.0  # m beside the path
    follower = replace(STANLEY, limit=0.5, rate=1.0)
    drive = standard_drive(follower, 1)
    slave = Slave(export_fmu(follower, tmp_path / "it.fmu"), tmp_path / "at")
    inputs = [v.name for v in slave.description.modelVariables if v.causality == "input"]
    row = dict(zip(inputs, drive.asked[0], strict=True))
    slave.set(**{n: v for n, v in row.items() if not n.startswith("applied")} | {"state.Y": row["state.Y"] - far})
    commands = []
    for applied in (1e300, np.nan, 0.0, 0.0, -0.3):
        slave.set(**{"applied.delta": applied})
        slave.step()
        commands.append(slave.get("delta")[0])
    most = follower.rate * follower.dt
    assert commands == pytest.approx([most, 2 * most, most, most, most - 0.3], abs=1e-12)
    slave.end()
