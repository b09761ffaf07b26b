"""FMUs of every kind of controller, each of whose parts is a file: they compile, and want what is wanted in Python."""

import zipfile

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.errors import ParameterError
from slipangle.export.drives import standard_drive
from slipangle.export.fmi import export_fmu
from tests.control.marx.test_adaptation import ADAPTIVE
from tests.control.marx.test_mpc import BY_POSE
from tests.export import test_followers, test_joined, test_mpc, test_switched, test_windows
from tests.export.test_fmi import BOTH, Slave
from tests.export.test_marx import INTEGRAL
from tests.export.tools import STRICT, needs, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
JOINED = ("scenarios and a parameter", "a parameter and a duration", "a corridor at two speeds", "a Huber cost")
CONTROLLERS = {
    "MPC": lambda: test_mpc.controller(4),
    "MPC with a corridor": lambda: test_mpc.controller(**test_mpc.KINDS["corridor and soft limits"]),
    "MARX": lambda: BY_POSE,
    "MARX with offsets": lambda: INTEGRAL,
    "MARX that learns": lambda: ADAPTIVE,
    "switched": lambda: test_switched.SWITCHED,
    "switched, two MPCs": lambda: test_switched.KINDS["two MPCs"],
    **{name: test_joined.KINDS[name] for name in (*JOINED, "an exact Hessian")},
    **{name: lambda name=name: test_followers.KINDS[name] for name in test_followers.KINDS},
}
NEWER = ("MARX", "switched", JOINED[0])  # in FMI 3.0, too
DRIVERS = {"for two speeds": (test_joined.driver, 2), "that looks back": (test_windows.driver, 3)}


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0")


@needs_compiler
@pytest.mark.parametrize(("kind", "version"), [*((k, 2) for k in CONTROLLERS), *((k, 3) for k in NEWER)])
def test_every_controller_decides_as_in_python(kind, version, tmp_path):
    """The recorded drive over again, its second half twice: the same commands to 1e-9, and no fallback."""
    controller = CONTROLLERS[kind]()
    drive = test_joined.recorded(controller, 12)  # of what is no vehicle, a drive of its own
    drive = standard_drive(controller, 12) if drive == 12 else drive
    slave = Slave(export_fmu(controller, tmp_path / "it.fmu", version=version), tmp_path / "at")
    inputs = [v.name for v in slave.description.modelVariables if v.causality == "input"]
    assert len(inputs) == drive.asked.shape[1]

    def driven(rows):
        said = []
        for row in rows:
            slave.set(**dict(zip(inputs, row, strict=True)))
            slave.step()
            said.append(slave.get(*controller.controls, "age", "stopping", "fallbacks"))
        return np.array(said)

    first, kept = driven(drive.asked[:6]), slave.fmu.getFMUState()
    later = driven(drive.asked[6:])
    slave.fmu.setFMUState(kept)
    slave.fmu.freeFMUState(kept)
    assert np.array_equal(driven(drive.asked[6:]), later)
    commands, fallbacks = np.split(np.vstack([first, later]), [len(controller.controls)], axis=1)
    assert commands == pytest.approx(drive.commands, abs=1e-9)
    assert np.abs(drive.commands).max() > 1e-6
    assert not fallbacks.any()
    slave.end()


@needs_compiler
@pytest.mark.parametrize("kind", DRIVERS)
def test_every_driver_wants_what_it_does_in_python(kind, tmp_path):
    made, version = DRIVERS[kind]
    whole = made()
    pilot = Slave(export_fmu(whole, tmp_path / "it.fmu", version=version), tmp_path / "at")
    told = dict(zip(("X", "Y", "psi"), whole.path.start, strict=True)) | {"v_x": 20.0, "r": 0.0}
    for k in range(8):
        told |= {"X": 20.0 * pilot.dt * k, "Y": 0.01 * k, "r": 1e-3 * k}
        pilot.set(**{f"measured.{n}": v for n, v in told.items()})
        pilot.step()
        said = whole.step(told, pilot.dt * k)
        assert pilot.get(*whole.controls) == pytest.approx([said[n] for n in whole.controls], abs=1e-9), k
    assert pilot.get("planned", "age") == pytest.approx([1.0, said.plan.age])
    pilot.end()


@BOTH
@pytest.mark.filterwarnings("ignore:no C compiler was found")
@pytest.mark.parametrize("kind", NEWER)
def test_sources_alone_are_whole(kind, version, tmp_path):
    """Every file that one includes is there, and each is listed and, where a compiler is, compiles without a word."""
    thing = CONTROLLERS[kind]()
    with zipfile.ZipFile(export_fmu(thing, tmp_path / "it.fmu", name="it", version=version, binary=False)) as archive:
        files = {n.rpartition("/")[2]: archive.read(n).decode() for n in archive.namelist()}
    described = files["buildDescription.xml" if version == 3 else "modelDescription.xml"]
    for name, text in files.items():
        (tmp_path / name).write_text(text)
        included = [line.split('"')[1] for line in text.splitlines() if line.startswith('#include "')]
        assert set(included) <= set(files), name
        assert (f'name="{name}"' in described) == name.endswith(".c")
    needs("gcc")
    for name in files:
        if name.endswith(".c"):
            run("gcc", *STRICT, "-fsyntax-only", name, folder=tmp_path)


def test_phases_have_no_fmu(tmp_path):
    with pytest.raises(ParameterError, match="a Phases has no C; expected a model"):
        export_fmu(sa.Phases([test_joined.spring()] * 2, links=[lambda x: [x[0], x[1]]]), tmp_path / "it.fmu")
