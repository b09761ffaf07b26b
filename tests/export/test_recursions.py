"""Exported recursive least squares learns what that in Python does, on any machine."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.errors import ParameterError, SimulationError
from slipangle.export.drives import Drive
from slipangle.export.kinds import project_of
from slipangle.export.precision import as_precision
from slipangle.identify.linear.recursive import RLS
from tests.export.tools import MACHINES, STRICT, built_and_run, needs, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
SETTINGS = {
    "one output": ({"na": 2, "nb": 2}, ("delta",), ("r",)),
    "directional, constant": ({"na": 2, "nb": 3, "forgetting": 0.99, "offset": True}, ("delta",), ("r",)),
    "two of each, fading": (
        {"na": 2, "nb": 1, "nk": 0, "forgetting": 0.98, "forget": "everywhere"},
        ("delta", "v_x"),
        ("v_y", "r"),
    ),
}
EACH = pytest.mark.parametrize("kind", SETTINGS)


def started(kind):
    """One that has learned a little already."""
    settings, inputs, outputs = SETTINGS[kind]
    made = RLS(**settings).start(inputs=inputs, outputs=outputs, dt=0.02)
    rng = np.random.default_rng(1)
    for _ in range(12):
        made.update(rng.normal(size=len(outputs)), rng.normal(size=len(inputs)))
    return made


def written(project, folder):
    for file, content in project.everything.items():
        (folder / file).write_text(content)
    return np.loadtxt(folder / "drive.csv", delimiter=",", skiprows=1)


def as_float(text):
    """A program's C for a library in single precision."""
    return text.replace("double", "float").replace("%lf", "%f")


def coefficients(said):
    return np.array([line.split(",") for line in said.split()], dtype=float)


@needs_compiler
@EACH
def test_same_as_python(kind, tmp_path):
    """Coefficients after each of 300 samples, to the last digits; what was exported did not move."""
    needs("gcc")
    own = started(kind)
    before = own.theta.copy()
    rows = written(project_of(own, "car", 300), tmp_path)
    assert np.array_equal(own.theta, before)
    run("gcc", "-std=c99", "-O1", "-o", "program", "car.c", "main.c", "-lm", folder=tmp_path)
    found = coefficients(run("./program", "--theta", folder=tmp_path, stdin=tmp_path / "drive.csv"))
    wanted = rows[:, -found.shape[1] :]
    assert found.shape == (300, own.theta.size)
    assert np.ptp(wanted, axis=0).max() > 0.1
    assert (np.abs(found - wanted) / (1 + np.abs(wanted))).max() < 1e-10


@needs_compiler
def test_restart_and_what_is_no_number(tmp_path):
    """As in Python: a gap empties the lags, and a sample that is none leaves all as it was."""
    needs("gcc")
    own = started("directional, constant")
    written(project_of(own, "car", 5), tmp_path)
    (tmp_path / "use.c").write_text("""
#include "car.h"
#include <math.h>
#include <stdio.h>
int main(void)
{
    static car_recursion r;
    static car_estimate e;
    double y[1] = {0.1}, u[1] = {0.2}, bad[1] = {NAN};
    if (car_start(&r, 8) != CAR_TOO_SMALL || car_start(&r, sizeof r) != CAR_OK)
        return 2;
    for (int k = 0; k < 30; k++) {
        if (k == 10)
            car_restart(&r);
        y[0] = 0.1 + 0.02 * (k % 3), u[0] = 0.3 * (k % 5);
        if (k == 20 && (car_update(&r, bad, u, &e) != CAR_NOT_FINITE || car_update(&r, y, bad, &e) != CAR_NOT_FINITE))
            return 3;
        if (car_update(&r, y, u, &e) != CAR_OK)
            return 4;
        printf("%.17g,%.17g,%.17g\\n", e.error[0], e.theta[0][0], e.noise[0][0]);
    }
    return 0;
}
""")
    run("gcc", "-std=c99", "-O1", "-o", "use", "car.c", "use.c", "-lm", folder=tmp_path)
    found = coefficients(run("./use", folder=tmp_path))
    for k, row in enumerate(found):
        if k in (0, 10):
            own.restart()
        error = own.update(0.1 + 0.02 * (k % 3), 0.3 * (k % 5))
        assert row == pytest.approx([error[0], own.theta[0], own.noise_covariance[0, 0]], rel=1e-9, abs=1e-12)
    assert found[0, 0] == found[11, 0] == 0.0 != found[13, 0]


@needs_compiler
@EACH
def test_a_start_is_a_new_drive(kind, tmp_path):
    """The lags that the log ended with are none of the car's that starts: they fill first, and nothing is unlearned."""
    needs("gcc")
    own = started(kind)
    rows = written(project_of(own, "car", 40), tmp_path)
    run("gcc", "-std=c99", "-O1", "-o", "program", "car.c", "main.c", "-lm", folder=tmp_path)
    found = coefficients(run("./program", "--theta", folder=tmp_path, stdin=tmp_path / "drive.csv"))
    known = own.theta
    n_y, n_u = len(own.outputs), len(own.inputs)
    assert (found[: own.memory] == known).all()
    assert (found[own.memory] != known).all()
    own.restart()
    for row, theta in zip(rows, found, strict=True):
        own.update(row[:n_y], row[n_y : n_y + n_u])
        assert theta == pytest.approx(own.theta, rel=1e-10, abs=1e-10)
    assert f"#define CAR_LAGS {own.memory}\n" in project_of(own, "car", 3).files["car.h"]


HUGE = """
#include "car.h"
#include <stdio.h>
int main(void)
{
    static car_recursion r;
    static car_estimate e;
    double line[3];
    if (car_start(&r, sizeof r) != CAR_OK)
        return 2;
    while (scanf("%lf %lf", line, line + 1) == 2) {
        int code = car_update(&r, line, line + 1, &e);
        if (code == CAR_NOT_FINITE)
            car_restart(&r);
        printf("%d,%.17g,%.17g,%.17g\\n", code, e.error[0], e.theta[0][0], e.noise[0][0]);
    }
    return CAR_DIVERGED != 3;
}
"""


@needs_compiler
@pytest.mark.parametrize("size", [1e8, 1e13, 1e20, 1e154, 1e300])
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("where", [0, 1], ids=["output", "input"])
def test_a_huge_sample_is_refused_and_forgotten(where, precision, size, tmp_path):
    """One that no channel reads moves nothing, and is said; the estimate goes on as Python's, and is always finite."""
    needs("gcc")
    own, rng = started("one output"), np.random.default_rng(3)
    written(as_precision(project_of(own, "car", 3), precision), tmp_path)
    (tmp_path / "use.c").write_text(HUGE if precision == "double" else as_float(HUGE))
    drive = rng.normal(size=(1500, 2))
    for k in range(1, len(drive)):
        drive[k, 0] = 0.6 * drive[k - 1, 0] + 0.4 * drive[k - 1, 1] + 0.05 * drive[k, 0]
    drive[500, where], drive[1000, where] = size, -size
    np.savetxt(tmp_path / "drive", np.where(np.abs(drive) > 3e38, np.inf, drive) if precision == "single" else drive)
    run("gcc", "-std=c99", "-O1", "-o", "use", "car.c", "use.c", "-lm", folder=tmp_path)
    found = coefficients(run("./use", folder=tmp_path, stdin=tmp_path / "drive"))
    refused = np.flatnonzero(found[:, 0])
    assert np.isfinite(found).all()
    if size > 1e12:
        assert refused.tolist() == [500, 1000]
        assert (found[refused, 0] == (2 if precision == "single" and size > 3e38 else 3)).all()
        assert (np.diff(found[499:501, 2:], axis=0) == 0).all()
        calm = np.abs(found[400:500, 1]).max()
        assert calm < 0.3
        assert (np.abs(found[refused[0] + 1 :, 1]) < 2 * calm).all()
    own.restart()
    for k, row in enumerate(drive):
        try:
            own.update(row[0], row[1])
        except SimulationError:
            assert k in refused
        if precision == "double" and size > 1e12:
            wanted = [own.theta[0], own.noise_covariance[0, 0]]
            assert found[k, 2:] == pytest.approx(wanted, rel=1e-9, abs=1e-12)


@EACH
@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_compilers_have_nothing_to_say(kind, compiler_, precision, tmp_path):
    needs(compiler_)
    written(as_precision(project_of(started(kind), "racer", 3), precision), tmp_path)
    for file in ("racer.c", "main.c"):
        run(compiler_, *STRICT, "-O1", "-fsyntax-only", file, folder=tmp_path)
    (tmp_path / "use.cpp").write_text(
        '#include "racer.hpp"\nint main() { racer::Recursion r; return r.update({}, {}); }'
    )
    if compiler_ == "gcc":
        needs("g++")
        run("g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "use.cpp", folder=tmp_path)


def test_a_record_is_replayed(tmp_path):
    needs("make", "gcc")
    rng = np.random.default_rng(2)
    data = sa.Dataset.from_arrays({"delta": rng.normal(size=80)}, {"r": rng.normal(size=80)}, 0.02)
    folder = sa.export.export(started("one output"), tmp_path / "made", name="racer", drive=data)
    assert "80 samples" in run("make", "-s", "replay", "strict", "CC=gcc", folder=folder)
    with pytest.raises(ParameterError, match="expected a Dataset"):
        project_of(started("one output"), "", Drive(columns=(), asked=rng, commands=rng, controls=()))


@needs_compiler
@EACH
def test_single_precision_learns_alike(kind, tmp_path):
    """To a hundredth of what the coefficients move by."""
    needs("gcc")
    rows = written(as_precision(project_of(started(kind), "car", 300), "single"), tmp_path)
    run("gcc", "-std=c99", "-O1", "-o", "program", "car.c", "main.c", "-lm", folder=tmp_path)
    found = coefficients(run("./program", "--theta", folder=tmp_path, stdin=tmp_path / "drive.csv"))
    wanted = rows[:, -found.shape[1] :]
    assert 0 < np.abs(found - wanted).max() < 0.01 * np.ptp(wanted, axis=0).max()


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", MACHINES)
def test_two_thousand_samples_on_every_machine(name, tmp_path):
    """The same coefficients to 1e-10 from every compiler and processor."""
    rows = written(project_of(started("directional, constant"), "car", 2000), tmp_path)
    said = built_and_run(name, ["car.c", "main.c"], tmp_path, "--theta", stdin=tmp_path / "drive.csv")
    found = coefficients(said)
    wanted = rows[:, -found.shape[1] :]
    assert len(found) == 2000
    assert (np.abs(found - wanted) / (1 + np.abs(wanted))).max() <= 1e-10
