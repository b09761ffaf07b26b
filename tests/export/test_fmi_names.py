"""Descriptions of FMUs: names keep their letters and are all different, and every variable that is set has a start."""

import math
import sys

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.export.fmi import export_fmu
from slipangle.export.fmi_description import Variable, unique
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from tests.export.test_fmi import BOTH, Slave

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
STEERED = sa.OnGround(sa.Steered(sa.Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("r",)), steering_lag=0.05))


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0")


def ode(states=("x",), inputs=("u",), **params):
    rates = lambda x, u, p: [u[0] - x[i] for i in range(len(states))]  # noqa: E731
    return sa.Ode(f=rates, states=states, inputs=inputs, outputs=(), params={"k": 1.0, **params}, dt=0.1)


@BOTH
def test_names_keep_their_letters(version, tmp_path):
    """All that XML can say but line ends and tabs; what importers read is what was meant."""
    import fmpy.validation

    model = ode(states=("Übergröße", 'a"b<c>&d'), inputs=("δ", "速度", "u\tv\nw", "\x01"))
    path = export_fmu(model, tmp_path / "it.fmu", version=version, binary=False)
    assert fmpy.validation.validate_fmu(str(path)) == []
    said = [v.name for v in fmpy.read_model_description(str(path)).modelVariables]
    assert said[:6] == ["state.Übergröße", 'state.a"b<c>&d', "δ", "速度", "u v w", "input"]


def test_names_are_all_different_and_never_empty():
    """Whatever the channels are called, with what is left of them or a number."""
    given = ["a", "a", "a 2", "time", "", " ", "\n", "u\tv", "u v", "\ud800", "δ", "δ"]
    made = [v.name for v in unique([Variable(name=n, causality="input") for n in given])]
    assert made == [
        "a", "a 2", "a 2 2", "time 2", "input", "input 2", "input 3", "u v", "u v 2", "input 4", "δ", "δ 2",
    ]  # fmt: skip
    assert len(set(made)) == len(given)


@BOTH
def test_an_infinite_parameter_starts_at_the_largest_number(version, tmp_path):
    """A description has no infinity, and a variable that can be set needs a start."""
    import fmpy.validation

    assert STEERED.off_ground.value("steering_rate") == math.inf
    for model in (STEERED, ode(least=-math.inf)):
        path = export_fmu(model, tmp_path / "it.fmu", version=version, binary=False, force=True)
        assert fmpy.validation.validate_fmu(str(path)) == []
        named = {v.name: v for v in fmpy.read_model_description(str(path)).modelVariables}
        starts = [float(named[n].start) for n in model.off_ground.parameter_names]
        assert all(map(math.isfinite, starts))
        assert sys.float_info.max in np.abs(starts)


@needs_compiler
@BOTH
def test_a_steering_rate_without_limit_can_be_limited(version, tmp_path):
    """It is none until one is set, and then that of the model with it."""
    slave = Slave(export_fmu(STEERED, tmp_path / "it.fmu", version=version), tmp_path / "at")
    x, u, turned = np.array(STEERED.straight(20.0)), np.array([0.1, 20.0]), []
    slave.set(**dict(zip(STEERED.inputs, u, strict=True)))
    for rate in (math.inf, 0.2):
        slave.set(steering_rate=slave.get("steering_rate")[0] if math.isinf(rate) else rate)
        model = sa.OnGround(STEERED.off_ground.with_values(steering_rate=rate))
        for _ in range(5):
            slave.step()
            x = np.asarray(model.step(x, u))
        assert slave.get(*(f"state.{n}" for n in model.states)) == pytest.approx(x, rel=1e-9, abs=1e-9)
        turned.append(x[model.states.index("delta_s")])
        u[0] = -u[0]
        slave.set(delta=u[0])
    assert turned[0] > 0.08
    assert turned[1] == pytest.approx(turned[0] - 5 * 0.02 * 0.2)
    slave.end()
