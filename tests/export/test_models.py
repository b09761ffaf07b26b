"""An exported model steps, measures and corrects as the one in Python does, on any machine."""

import ctypes

import numpy as np
import pytest

from slipangle.codegen import compiler
from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, WriteError
from slipangle.export.kinds import project_of
from tests.export.loaded import as_one
from tests.export.tools import MACHINES, STRICT, built_and_run, needs, run
from tests.models.all_models import ALL_MODELS, typical

EVERY = pytest.mark.parametrize("name", ALL_MODELS)
needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
FEW = ("bicycle", "NARX", "single track, Radau", "dual track, front drive")


def loaded(files):
    return compiler.library(as_one(files), name="model")


@needs_compiler
@EVERY
def test_same_as_python(name, monkeypatch):
    """Step, outputs and correction at states that the model knows."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0")
    model, rng = ALL_MODELS[name], np.random.default_rng(3)
    library = loaded(project_of(model, "car", 3).everything)
    step, output, correct = model.functions
    for _ in range(5):
        x, u = (np.ascontiguousarray(v, dtype=float) for v in typical(model, rng))
        u = u if len(u) else np.zeros(1)
        y = np.ascontiguousarray(np.asarray(output(x, u[: model.n_inputs])).ravel() + 0.01)
        for function, given, wanted in (
            (library.car_step, (x, u), step(x, u[: model.n_inputs])),
            (library.car_output, (x, u), output(x, u[: model.n_inputs])),
            (library.car_correct, (x, u, y), correct(x, u[: model.n_inputs], y)),
        ):
            found = np.full(np.asarray(wanted).size, 7.0)
            function.argtypes = [ctypes.c_void_p] * (len(given) + 1)
            function(*(a.ctypes.data for a in given), found.ctypes.data)
            assert found == pytest.approx(np.asarray(wanted).ravel(), rel=1e-9, abs=1e-9)


@needs_compiler
@EVERY
def test_nothing_is_made_of_what_is_no_number(name, monkeypatch):
    """What moves with a state or input that is NaN or infinite is NaN: minima, maxima and signs of C would drop it."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0")
    model, rng = ALL_MODELS[name], np.random.default_rng(4)
    library = loaded(project_of(model, "car", 3).everything)
    x, u = (np.ascontiguousarray(v, dtype=float) for v in typical(model, rng))
    step = library.car_step
    step.argtypes = [ctypes.c_void_p] * 3
    usual, both = np.asarray(model.functions[0](x, u)).ravel(), np.concatenate([x, u])
    for j in range(len(both)):
        moved = np.zeros(len(x), dtype=bool)
        for way in (0.9, 1.1):
            other = both.copy()
            other[j] = way * other[j] + 0.01
            moved |= np.asarray(model.functions[0](other[: len(x)], other[len(x) :])).ravel() != usual
        for bad in (np.nan, np.inf):
            other[j] = bad
            now, given, found = other[: len(x)].copy(), np.append(other[len(x) :], 0.0), np.zeros(len(x))
            step(now.ctypes.data, given.ctypes.data, found.ctypes.data)
            assert np.isnan(found[moved]).all(), j
            known = ~np.isnan(found)
            assert found[known] == pytest.approx(usual[known], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
@EVERY
def test_compilers_have_nothing_to_say(name, compiler_, tmp_path):
    needs(compiler_)
    for file, content in project_of(ALL_MODELS[name], "car", 3).everything.items():
        (tmp_path / file).write_text(content)
    for file in ("car.c", "main.c"):
        run(compiler_, *STRICT, "-fsyntax-only", file, folder=tmp_path)


def test_wrapper_for_cpp(tmp_path):
    needs("g++")
    use = """
#include "car.hpp"
int main()
{
    car::Model model(car::State{});
    model.step({});
    model.correct({}, model.output({}));
    return model.state()[0] == model.state()[0] ? 0 : 1;
}
"""
    for file, content in {**project_of(ALL_MODELS["bicycle"], "car", 3).everything, "use.cpp": use}.items():
        (tmp_path / file).write_text(content)
    run("g++", "-std=c++17", *STRICT[1:5], "-fsyntax-only", "use.cpp", folder=tmp_path)


def test_replays_the_free_run_of_data(tmp_path):
    """From the start that the model takes from its data, with their inputs."""
    needs("gcc", "make")
    model, rng = ALL_MODELS["bicycle"], np.random.default_rng(2)
    delta = np.cumsum(rng.normal(0, 0.003, 80))
    measured = {n: 0.1 * rng.normal(size=80) for n in model.outputs}
    data = Dataset.from_arrays({"delta": delta, "v_x": np.full(80, 17.0)}, measured, model.dt)
    folder = model.export(tmp_path / "made", drive=data)
    table = np.loadtxt(folder / "drive.csv", delimiter=",", skiprows=1)
    free = model.simulate(data).y
    assert table[1:, -model.n_outputs :] == pytest.approx(free[1:], rel=1e-9, abs=1e-12)
    assert "80 samples of a free run" in run("make", "-s", "replay", "CC=gcc", "CFLAGS=-O1", folder=folder)
    with pytest.raises(WriteError, match="not empty"):
        model.export(folder)


def test_what_a_model_cannot_be_given():
    with pytest.raises(ParameterError, match="is that of a controller; expected a Dataset"):
        project_of(ALL_MODELS["bicycle"], "car", drive_of_nothing())
    with pytest.raises(ParameterError, match="a str has no C"):
        project_of("bicycle", "car", 3)


def drive_of_nothing():
    from slipangle.export.drives import Drive

    none = np.empty((0, 1))
    return Drive(columns=(), asked=none, commands=none, controls=())


@pytest.mark.slow
@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("name", FEW)
def test_free_runs_on_every_machine(machine, name, tmp_path):
    for file, content in project_of(ALL_MODELS[name], "car", 300).everything.items():
        (tmp_path / file).write_text(content)
    wanted = np.loadtxt(tmp_path / "drive.csv", delimiter=",", skiprows=1)[:, -ALL_MODELS[name].n_outputs :]
    said = built_and_run(machine, ["car.c", "main.c"], tmp_path, "--outputs", stdin=tmp_path / "drive.csv")
    found = np.array([line.split(",") for line in said.split()], dtype=float)
    assert found.shape == wanted.shape
    assert np.abs(wanted).max() > 1e-3
    assert found == pytest.approx(wanted, rel=1e-10, abs=1e-10)
