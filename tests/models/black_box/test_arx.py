"""ARX models: every way to run freely gives the same, with delays, feedthrough, several inputs and outputs."""

import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, SimulationError
from slipangle.models.black_box import arx, arx_code
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.model import Model

SHAPES = pytest.mark.parametrize(
    ("na", "nb", "nk", "nu", "ny"),
    [
        (1, 1, 1, 1, 1),
        (2, 5, 1, 1, 1),
        (10, 10, 1, 1, 1),
        (20, 3, 4, 2, 1),
        (3, 1, 0, 1, 1),
        (2, 3, 0, 2, 1),
        (1, 1, 1, 1, 2),
        (2, 3, 2, 2, 3),
        (3, 2, 0, 2, 2),
    ],
)


def stable(na, nb, nk, nu, ny, seed=0, constant=True):
    rng = np.random.default_rng(seed)
    A = 0.6 / (na * ny) * rng.uniform(-1, 1, (na, ny, ny))
    names = tuple(f"u{i}" for i in range(nu)), tuple(f"y{i}" for i in range(ny))
    c = rng.standard_normal(ny) if constant else None
    return ARXModel(A=A, B=rng.standard_normal((nb, ny, nu)), c=c, nk=nk, dt=0.1, inputs=names[0], outputs=names[1])


def record(model, n, seed=1, apart=False):
    """Random data; ``apart`` puts another channel between the inputs."""
    rng = np.random.default_rng(seed)
    inputs = {name: rng.standard_normal(n) for name in model.inputs}
    outputs = {name: rng.standard_normal(n) for name in model.outputs}
    if not apart:
        return Dataset.from_arrays(inputs, outputs, model.dt)
    first, *rest = inputs
    table = {first: inputs[first], **outputs, **{name: inputs[name] for name in rest}}
    return Dataset.from_arrays(table, {}, model.dt).select(inputs=model.inputs, outputs=model.outputs)


@pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
@SHAPES
@pytest.mark.parametrize("n", [100, arx_code.BLOCK, arx_code.BLOCK + 1, 2500])
def test_compiled_free_run_is_repeated_step(monkeypatch, na, nb, nk, nu, ny, n):
    model = stable(na, nb, nk, nu, ny)
    data = record(model, n + model.memory, apart=nu > 1)
    m = model.memory
    x0, u = model.initial_state(data.head(m)), data.u[m - 1 :]
    slow = Model.free_run(model, x0, u)
    monkeypatch.setattr(arx, "_LONG", 1)
    monkeypatch.setattr(arx, "_filtered", None)  # not used
    assert model.simulate(data).y[m:] == pytest.approx(slow, rel=1e-10, abs=1e-10)
    other = model.simulate(data, start=[2 * x0])
    assert other.y[m:] == pytest.approx(Model.free_run(model, 2 * x0, u), rel=1e-10, abs=1e-10)


@SHAPES
def test_without_a_compiler_it_is_the_same(monkeypatch, na, nb, nk, nu, ny):
    model = stable(na, nb, nk, nu, ny, constant=ny > 1)
    data = record(model, 500)
    m = model.memory
    x0, u = model.initial_state(data.head(m)), data.u[m - 1 :]
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    monkeypatch.setattr(arx, "_LONG", 1)
    assert model.simulate(data).y[m:] == pytest.approx(Model.free_run(model, x0, u), rel=1e-10, abs=1e-10)


def test_feedthrough_is_the_difference_equation():
    model = stable(2, 3, 0, 2, 2)
    data = record(model, 50)
    y, u = data.y.copy(), data.u
    for k in range(model.memory, 50):
        y[k] = model.c - sum(model.A[i] @ y[k - 1 - i] for i in range(2)) + sum(model.B[j] @ u[k - j] for j in range(3))
    assert model.memory == 3
    assert model.simulate(data).y == pytest.approx(y, abs=1e-12)
    one = model.predict(data)
    k = 30
    expected = model.c - sum(model.A[i] @ data.y[k - 1 - i] for i in range(2))
    assert one.y[k] == pytest.approx(expected + sum(model.B[j] @ u[k - j] for j in range(3)), abs=1e-12)


def test_long_lags_and_an_unstable_model():
    model = stable(2, 1, arx_code.BLOCK + 5, 1, 1)  # more than the compiled code keeps
    data = record(model, 60_000)
    m = model.memory
    short = model.simulate(data.head(m + 200)).y
    assert model.simulate(data).y[: m + 200] == pytest.approx(short, abs=1e-12)
    unstable = ARXModel(A=[-1.01], B=[1.0], dt=0.1, inputs=("u0",), outputs=("y0",))
    with pytest.raises(SimulationError, match=r"at sample (7\d{4}) \(t = 7\d+"):
        unstable.simulate(record(unstable, 100_000))


def test_coefficients_of_a_wrong_shape_are_refused():
    with pytest.raises(ParameterError, match="nk is -1"):
        ARXModel(A=[0.1], B=[1.0], nk=-1, dt=0.1, inputs=("u",), outputs=("y",))
    with pytest.raises(ParameterError, match=r"expected \(na, 1, 1\) and \(nb, 1, 2\)"):
        ARXModel(A=[0.1], B=[1.0], dt=0.1, inputs=("u", "v"), outputs=("y",))
