"""Exported MARX-MPC decides what the one in Python does, in any state of mind, on any machine."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen import compiler
from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.marx.solver import FLAGS
from slipangle.export.kinds import project_of
from slipangle.optimal.ocp import Reference
from slipangle.optimal.terms import Limits, Values, Weights
from tests.control.marx.test_mpc import BY_POSE, BY_Y, GROUND, SETTINGS, situation
from tests.export.loaded import Loaded, same
from tests.export.tools import MACHINES, STRICT, driven_on, needs, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
INTEGRAL = MultiARXMPC(
    GROUND,
    Q=Weights(e_y=100.0, e_psi=20.0),
    rates=Limits(delta=1.0),
    integral=0.2,
    knots=(0, 1, 3, 7),
    safe=Values(delta=0.05),
    **SETTINGS,
)
KINDS = {"Y": BY_Y, "on the ground": BY_POSE, "integral, knots, rates": INTEGRAL}


def upset(x, reference, k, rng):
    x, path, v = np.array(x), np.array(reference.tracked), np.array(reference.exogenous)
    if k % 11 == 5:
        x[rng.integers(len(x))] = rng.choice([np.nan, np.inf, 1e9, -1e200])
    if k % 13 == 6:
        path[rng.integers(len(path)), rng.integers(3)] = rng.choice([np.nan, 1e9])
    if k % 17 == 8:
        v[0] = rng.choice([0.5, -3.0, 40.0, np.nan, 500.0])
    return x, Reference(tracked=path, exogenous=v)


@needs_compiler
@pytest.mark.parametrize("kind", KINDS)
def test_same_as_python_to_the_last_bit_whatever_happens(kind, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1 -march=native")
    mpc = replace(KINDS[kind])
    exported = Loaded(project_of(mpc, "car", 3).everything, FLAGS)
    rng, previous, seen = np.random.default_rng(5), None, set()
    known = KINDS[kind] is BY_Y
    for k in range(150):
        x, reference, given = situation(BY_Y if known else mpc, k)
        x, reference = upset(x, reference, k, rng)
        applied = rng.choice([given[0], -0.5, np.nan, 1e13]) * np.ones(1) if k % 5 == 2 else None
        previous = mpc.plan(x, reference, previous, applied=applied)
        out = exported.plan(x, reference, applied)
        assert same(out, previous), (k, previous.message)
        seen.add((previous.status.name, previous.stopping))
    assert {("SOLVED", False), ("NOT_FINITE", False), ("IMPLAUSIBLE", False), ("FAILED", False)} <= seen


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
def test_compilers_have_nothing_to_say(kind, compiler_, tmp_path):
    needs(compiler_)
    for file, content in project_of(KINDS[kind], "car", 3).everything.items():
        (tmp_path / file).write_text(content)
    for simd in ("-march=native", "-DCAR_LANES=1"):
        for file in ("car.c", "main.c"):
            run(compiler_, *STRICT, simd, "-fsyntax-only", file, folder=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_two_thousand_steps_on_every_machine(name, tmp_path):
    needs()
    commands, wanted = driven_on(name, INTEGRAL, tmp_path)
    assert np.abs(commands - wanted).max() <= 1e-10
