"""Exported models that learn while driving learn what they learn in Python, from the same samples."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen import compiler
from slipangle.control.marx.adaptation import AdaptiveMultiARXMPC, Lesson, Supervisor
from slipangle.control.marx.solver import FLAGS
from slipangle.export.kinds import project_of
from slipangle.export.precision import as_precision
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.ocp import Reference
from tests.control.marx.test_adaptation import ADAPTIVE, BASE, FREE, model, reference
from tests.export.loaded import STATUSES, Loaded
from tests.export.tools import MACHINES, STRICT, driven_on, needs, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
LESSONS = list(Lesson)
INTEGRAL = AdaptiveMultiARXMPC(replace(BASE, integral=0.2), supervisor=replace(FREE, excitation=0.05), forgetting=0.95)
STRICTLY = AdaptiveMultiARXMPC(BASE, prior=5.0, supervisor=Supervisor(lateral=0.3, gain=1.05, surprise=1e6))
KINDS = {  # controller, gain of the true car over its own, lessons that must be seen
    "free": (ADAPTIVE, 1.4, {"LEARNED", "SURPRISING", "WAITING"}),
    "integral, forgets sooner": (INTEGRAL, 1.2, {"LEARNED", "QUIET", "OUTSIDE"}),
    "strict": (STRICTLY, -1.0, {"DOUBTFUL", "SATURATED", "OUTSIDE"}),
}


@needs_compiler
@pytest.mark.parametrize("kind", KINDS)
def test_same_lessons_and_commands_as_python(kind, monkeypatch):
    """Commands to 1e-9 after 400 samples, some of them missing or wild; every verdict."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1 -march=native")
    controller, gain, wanted = KINDS[kind]
    exported = Loaded(project_of(controller, "car", 3).everything, FLAGS)
    truth, rng = OnGround(model(gain=gain)), np.random.default_rng(1)
    x, plan, seen = np.zeros(truth.n_states), None, set()
    for k in range(400):
        calm = 100 < k < 180
        ahead = reference(14.0 + 6.5 * np.sin(0.05 * k), 0.0 if calm else 0.3 * rng.standard_normal())
        ahead.tracked[:, 0] += x[-3]
        given, applied = x.copy(), np.array([0.01]) if k % 9 == 4 else None
        if k % 50 == 7:
            given[rng.integers(len(x))] = (np.nan, np.inf, 1e9)[k // 50 % 3]
        if k % 60 == 9:
            given[1] += 3.0
        if k % 90 == 13:
            ahead = Reference(tracked=ahead.tracked, exogenous=np.full((10, 1), np.nan))
        plan = controller.plan(given, ahead, plan, applied=applied)
        out = exported.plan(given, ahead, applied)
        assert STATUSES[out.status] is plan.status, k
        assert LESSONS[out.lesson] is plan.verdict, k
        assert (out.samples, out.age, bool(out.stopping)) == (plan.samples, plan.age, plan.stopping)
        assert np.array(out.u) == pytest.approx(plan.u, abs=1e-9)
        assert np.array(out.x) == pytest.approx(plan.x, rel=1e-9, abs=1e-8)
        seen.add(plan.verdict.name)
        v = float(np.nan_to_num(ahead.exogenous[0, 0], nan=14.0))
        x = np.asarray(truth.step(x, np.array([0.0 if calm else plan.command[0], v])))
        if np.abs(x[:2]).max() > 3.0 or not np.isfinite(x).all():
            x = np.zeros(truth.n_states)
    assert wanted <= seen


@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_compilers_have_nothing_to_say(compiler_, precision, tmp_path):
    needs(compiler_)
    project = as_precision(project_of(INTEGRAL, "racer", 3), precision)
    for file, content in project.everything.items():
        (tmp_path / file).write_text(content)
    for file in ("racer.c", "main.c"):
        run(compiler_, *STRICT, "-O1", "-fsyntax-only", file, folder=tmp_path)
    assert "which learn" in project.everything["racer.h"]


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", MACHINES)
def test_two_thousand_steps_on_every_machine(name, tmp_path):
    commands, wanted = driven_on(name, ADAPTIVE, tmp_path)
    assert np.abs(commands - wanted).max() <= 1e-10
