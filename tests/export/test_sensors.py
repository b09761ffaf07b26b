"""An exported virtual sensor says what that in Python does, and is silent where that is, on any machine."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.errors import ParameterError
from slipangle.estimate.side_slip_sensor import CHANNELS
from slipangle.export.drives import Drive
from slipangle.export.kinds import project_of
from slipangle.export.precision import as_precision
from tests.estimate.test_side_slip_sensor import DT, SENSOR, driven
from tests.export.tools import MACHINES, STRICT, built_and_run, needs, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
EXACT = ("-std=c99", "-O1", "-ffp-contract=off")
LEARNED = SENSOR.fit(driven(1))


def channels(seed, n):
    """Samples as a car has them: some missing, some infinite, some slow, some harder than any that was learned."""
    rng = np.random.default_rng(seed)
    table = driven(seed, n=max(n, 1000)).columns(CHANNELS)[:n].copy()
    table[n // 5 : n // 5 + 20, 1] = 1.0
    table[n // 3 : n // 3 + 20, 3] += 15.0
    table[rng.uniform(size=table.shape) < 0.003] = np.nan
    table[rng.uniform(size=table.shape) < 0.001] = np.inf
    return table


def written(project, folder):
    for file, content in project.everything.items():
        (folder / file).write_text(content)
    return np.loadtxt(folder / "drive.csv", delimiter=",", skiprows=1)


def replayed(table):
    """As a drive, which the record of a car with faults is."""
    stream = LEARNED.begin()
    said = [stream.take(dict(zip(CHANNELS, row, strict=True))) for row in table.tolist()]
    rows = np.column_stack([table, said])
    return rows, ",".join([*CHANNELS, "v_y"]) + "\n" + "\n".join(",".join(map(repr, r)) for r in rows.tolist()) + "\n"


def off(said, rows):
    """Largest difference relative to one more than the number; infinite where one speaks and the other does not."""
    found = np.array(said.split(), dtype=float)
    assert len(found) == len(rows)
    assert np.array_equal(np.isnan(found), np.isnan(rows[:, -1]))
    return np.nanmax(np.abs(found - rows[:, -1]) / (1 + np.abs(rows[:, -1])))


@needs_compiler
def test_same_as_python(tmp_path):
    """Of 3000 samples with faults, a fifth of them silent; and silent at the same."""
    needs("gcc")
    written(project_of(LEARNED, "car", 30), tmp_path)
    rows, text = replayed(channels(2, 3000))
    (tmp_path / "faulty.csv").write_text(text)
    run("gcc", *EXACT, "-o", "program", "car.c", "main.c", "-lm", folder=tmp_path)
    silent = np.isnan(rows[:, -1])
    assert 0.05 < silent.mean() < 0.5
    assert off(run("./program", "--v_y", folder=tmp_path, stdin=tmp_path / "faulty.csv"), rows) == 0.0
    assert "3000 samples" in run("./program", folder=tmp_path, stdin=tmp_path / "faulty.csv")


@needs_compiler
def test_one_implausible_sample_silences_it_until_it_is_forgotten(tmp_path):
    """In C and Python alike, whatever channel it is in."""
    needs("gcc")
    written(project_of(LEARNED, "car", 30), tmp_path)
    run("gcc", *EXACT, "-o", "program", "car.c", "main.c", "-lm", folder=tmp_path)
    table, first = driven(3, n=1000).columns(CHANNELS).copy(), LEARNED.look.first
    rows, _ = replayed(table)
    at = [k for k in range(200, 900, 90) if np.isfinite(rows[k - first : k + 2 * first, -1]).all()][:5]
    for k, (channel, value) in zip(at, ((3, 15.0), (3, 100.0), (2, 3.0), (0, 1.0), (1, 90.0)), strict=True):
        table[k, channel] = value
    rows, text = replayed(table)
    (tmp_path / "faulty.csv").write_text(text)
    assert off(run("./program", "--v_y", folder=tmp_path, stdin=tmp_path / "faulty.csv"), rows) == 0.0
    for k in at:
        assert np.isnan(rows[k : k + first - LEARNED.look.turn + 1, -1]).all()
        assert np.isfinite(rows[k + first + 1, -1])


@needs_compiler
def test_a_drive_of_its_own_speaks(tmp_path):
    """What an export without a record replays is said for the most part, left and right."""
    rows = written(project_of(LEARNED, "car", 400), tmp_path)
    assert np.isfinite(rows[:, -1]).mean() > 0.7
    assert np.nanmin(rows[:, -1]) < -0.1 < 0.1 < np.nanmax(rows[:, -1])


@needs_compiler
def test_after_a_gap_it_waits(tmp_path):
    """As one that is new; memory that is too small is refused."""
    needs("gcc")
    written(project_of(LEARNED, "car", 5), tmp_path)
    (tmp_path / "use.c").write_text("""
#include "car.h"
#include <stdio.h>
int main(void)
{
    static car_sensor s;
    static car_estimate e;
    double channels[CAR_CHANNELS] = {0.01, 25, 0.1, 2.5};
    if (car_start(&s, 8) != CAR_TOO_SMALL || car_start(&s, sizeof s) != CAR_OK)
        return 2;
    for (int k = 0; k < 40; k++) {
        if (k == 20)
            car_restart(&s);
        int code = car_update(&s, channels, &e);
        printf("%d %.17g\\n", code == CAR_OK, e.side_slip);
    }
    return 0;
}
""")
    run("gcc", "-std=c99", "-O1", "-o", "use", "car.c", "use.c", "-lm", folder=tmp_path)
    found = np.array(run("./use", folder=tmp_path).split(), dtype=float).reshape(40, 2)
    new = np.flatnonzero(found[:20, 0])[0]
    assert new == LEARNED.look.first
    assert np.array_equal(found[:20], found[20:], equal_nan=True)
    stream = LEARNED.begin()
    v_y = [stream.take(dict(zip(CHANNELS, [0.01, 25, 0.1, 2.5], strict=True))) for _ in range(20)]
    assert 25 * np.tan(found[new:20, 1]) == pytest.approx(v_y[new:], rel=1e-10)


@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_compilers_have_nothing_to_say(compiler_, precision, tmp_path):
    needs(compiler_)
    written(as_precision(project_of(LEARNED, "racer", 3), precision), tmp_path)
    for file in ("racer.c", "main.c"):
        run(compiler_, *STRICT, "-O1", "-fsyntax-only", file, folder=tmp_path)
    (tmp_path / "use.cpp").write_text('#include "racer.hpp"\nint main() { racer::Sensor s; return s.update({}); }')
    if compiler_ == "gcc":
        needs("g++")
        run("g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "use.cpp", folder=tmp_path)


def test_a_record_is_replayed(tmp_path):
    needs("make", "gcc")
    folder = LEARNED.export(tmp_path / "made", name="racer", drive=driven(3, n=300))
    assert "300 samples" in run("make", "-s", "replay", "strict", "CC=gcc", folder=folder)
    with pytest.raises(ParameterError, match="expected a Dataset"):
        project_of(LEARNED, "", Drive(columns=(), asked=np.zeros(1), commands=np.zeros(1), controls=()))


@needs_compiler
def test_single_precision_says_alike(tmp_path):
    """To a thousandth of what it says."""
    needs("gcc")
    rows = written(as_precision(project_of(LEARNED, "car", 400), "single"), tmp_path)
    run("gcc", "-std=c99", "-O1", "-o", "program", "car.c", "main.c", "-lm", folder=tmp_path)
    found = np.array(run("./program", "--v_y", folder=tmp_path, stdin=tmp_path / "drive.csv").split(), dtype=float)
    both = np.isfinite(found) & np.isfinite(rows[:, -1])
    assert both.sum() >= np.isfinite(rows[:, -1]).sum() - 5
    assert 0 < np.abs(found - rows[:, -1])[both].max() < 1e-3 * np.nanmax(np.abs(rows[:, -1]))


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", MACHINES)
def test_two_thousand_samples_on_every_machine(name, tmp_path):
    """The same to 1e-10 from every compiler and processor."""
    rows = written(project_of(LEARNED, "car", 2000), tmp_path)
    said = built_and_run(name, ["car.c", "main.c"], tmp_path, "--v_y", stdin=tmp_path / "drive.csv")
    assert off(said, rows) <= 1e-10


def test_it_is_exported_at_its_own_sample_time(tmp_path):
    other = driven(1).resample(2 * DT)
    with pytest.raises(sa.errors.SampleTimeError):
        LEARNED.export(tmp_path / "made", drive=other)
    assert not (tmp_path / "made").exists()
