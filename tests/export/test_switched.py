"""An exported switched controller takes turns as the one in Python does, and its parts decide the same."""

import ctypes
import itertools
from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.mpc import MPC
from slipangle.control.switched import SwitchedMPC
from slipangle.errors import ParameterError
from slipangle.export.drives import standard_drive
from slipangle.export.kinds import project_of
from slipangle.export.precision import as_precision
from slipangle.optimal.ocp import Reference
from slipangle.optimal.terms import Limits, Weights
from tests.control.test_switched import BICYCLE, CALM, LIMIT, SETTINGS, SWITCHED, V, bend
from tests.export.loaded import STATUSES, Loaded, defines
from tests.export.tools import MACHINES, STRICT, driven_on, needs, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
EAGER = MPC(BICYCLE, **(SETTINGS | {"S": Weights(delta=100.0), "rates": Limits(delta=2.0)}))
KINDS = {
    "MARX and MPC": SWITCHED,
    "two MPCs": SwitchedMPC(LIMIT, EAGER, enter=0.3, leave=0.2, dwell=5),
    "MARX with offsets": replace(SWITCHED, calm=replace(CALM, integral=0.2), friction=0.8, dwell=2),
    "MPC and MARX": SwitchedMPC(LIMIT, MultiARXMPC(CALM.model, **SETTINGS), enter=0.3, leave=0.2, dwell=3),
}


class LoadedParts(Loaded):
    """Loaded from its three files."""

    folder = None

    @staticmethod
    def more(files):
        sizes = [defines(files[f"car_{n}.h"], f"CAR_{n.upper()}") for n in ("calm", "limit")]
        return sum(n["BYTES"] for n in sizes) + 1_000_000

    def compiled(self, files, flags):
        for name, text in files.items():
            (self.folder / name).write_text(text)
        sources = ("car.c", "car_calm.c", "car_limit.c")
        given = (*flags, *compiler._levels()[0], "-shared", "-fPIC", "-std=gnu11")
        run(*compiler.compiler(), *given, "-o", "all.so", *sources, "-lm", folder=self.folder)
        return ctypes.CDLL(str(self.folder / "all.so"))


@needs_compiler
@pytest.mark.parametrize("kind", [pytest.param(k, marks=[pytest.mark.slow] * (k == "MPC and MARX")) for k in KINDS])
def test_takes_turns_as_python_does_whatever_happens(kind, tmp_path, monkeypatch):
    """Which one plans, its commands and statuses to 1e-9, fallbacks over a change of turns too."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")
    controller = KINDS[kind]
    LoadedParts.folder = tmp_path
    project = project_of(controller, "car", 3)
    exported = LoadedParts(project.everything, project.flags)
    rng, previous, seen = np.random.default_rng(7), None, set()
    states = controller.model.states
    turns = [0.0] * 8 + [0.02] * 6 + [0.011] * 10 + [0.0] * 16
    for k in range(240):
        reference = bend(turns[k % len(turns)])
        x = np.zeros(len(states))
        for n in ("r", "r'"):
            x[states.index(n)] = V * turns[k % len(turns)] + 0.01 * rng.normal()
        for n in ("Y", "Y'"):
            x[states.index(n)] = 0.01 * np.sin(0.2 * k)
        at = k % len(turns)
        if 9 <= at < 24 and k % 7 in (3, 4):
            x[rng.integers(len(x))] = (np.nan, np.inf, 1e13, -1e200)[k % 4]
        if k % 80 in (7, 8, 48, 49):  # as the limit's controller takes over
            x[-3] = x[len(x) // 2 - 2] = np.nan
        if k % 80 in (33, 34, 35):  # as it gives back
            x[[i for i, n in enumerate(states) if n.startswith("X")]] = np.nan
        if 9 <= at < 24 and k % 23 == 8:
            reference = Reference(tracked=reference.tracked, exogenous=np.full((10, 1), (np.nan, 0.5)[k % 2]))
        applied = np.array([(0.01, np.nan, -0.5)[k % 3]]) if k % 5 == 2 else None
        before = None if previous is None else previous.active
        previous = controller.plan(x, reference, previous, applied=applied)
        out = exported.plan(x, reference, applied)
        assert out.active == previous.active, k
        assert out.demand == pytest.approx(previous.demand, rel=1e-9)
        assert STATUSES[out.status] is previous.status, (k, previous.message)
        assert (out.age, bool(out.stopping)) == (previous.age, previous.stopping), (k, previous.message)
        assert np.array(out.u) == pytest.approx(previous.u, abs=1e-9), (k, previous.message)
        assert tuple(getattr(out.health, n) for n, _ in out.health._fields_) == tuple(previous.health)
        if not previous.age:
            first = controller.calm.model.n_states if previous.active else 0
            part = np.array(out.x)[:, first : first + previous.x.shape[1]]
            assert part == pytest.approx(previous.x, rel=1e-8, abs=1e-8)
            assert np.isnan(np.array(out.x)).sum() == len(out.x[0]) * 11 - previous.x.size
        seen.add((before, previous.active, previous.age > 0))
    if kind == "two MPCs":
        clock = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p)(lambda of: next(ticks))
        ticks, counted = itertools.count(), exported.plan(np.zeros(len(states)), bend(0.0)).health.overruns
        for seconds, overruns in ((-1.0, 1), (np.nan, 2), (0.0, 2)):
            exported.limit(0, seconds, ctypes.cast(clock, ctypes.c_void_p))
            out = exported.plan(np.zeros(len(states)), bend(0.0))
            assert (out.status == 4, out.health.overruns - counted) == (seconds != 0.0, overruns)
    assert {(0, 0, False), (0, 1, False), (1, 1, False), (1, 0, False), (0, 1, True)} <= seen


@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
@pytest.mark.parametrize(
    ("kind", "precision"),
    [
        ("MARX and MPC", "double"),
        pytest.param("MPC and MARX", "double", marks=pytest.mark.slow),
        pytest.param("MARX and MPC", "single", marks=pytest.mark.slow),
        ("MPC and MARX", "single"),
    ],
)
def test_compilers_have_nothing_to_say(kind, compiler_, precision, tmp_path):
    needs(compiler_)
    project = as_precision(project_of(KINDS[kind], "racer", 3), precision)
    for file, content in project.everything.items():
        (tmp_path / file).write_text(content)
    for file in [*(s.replace("car", "racer") for s in project.sources), "main.c"]:
        run(compiler_, *STRICT, "-O1", "-fsyntax-only", file, folder=tmp_path)


@needs_compiler
def test_a_built_one_drives(tmp_path, monkeypatch):
    """Loaded without a compiler, on its own drive."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")
    drive = standard_drive(SWITCHED, 60)
    built = sa.export.load(sa.export.build(SWITCHED, tmp_path / "made", drive=drive))
    x = np.zeros(SWITCHED.model.n_states)
    assert built.plan(x, bend(0.02)).command == pytest.approx(SWITCHED.plan(x, bend(0.02)).command, abs=1e-9)
    assert drive.commands.std() > 1e-3


def test_parts_that_cannot_be_handed_over_are_said():
    """A corridor is no part of what both are told."""
    narrow = replace(LIMIT, corridor=1.8, slack=Weights(e_y=1e3))
    with pytest.raises(ParameterError, match="corridor, which it cannot be handed in C"):
        project_of(replace(SWITCHED, limit=narrow), "car", 3)


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", MACHINES)
def test_two_thousand_steps_on_every_machine(name, tmp_path):
    commands, wanted = driven_on(name, SWITCHED, tmp_path)
    assert np.abs(commands - wanted).max() <= 1e-10
