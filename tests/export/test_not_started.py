"""What exported code answers where its start was forgotten: that, and nothing that could be taken for an estimate."""

import pytest

from slipangle.codegen import compiler
from slipangle.export.kinds import project_of
from tests.export import test_drivers, test_estimators, test_racers, test_windows
from tests.export.test_recursions import started
from tests.export.tools import needs, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
PROGRAM = """
#include "car.h"
#include <math.h>
#include <stdio.h>
#include <string.h>
@OBJECTS@
int main(void)
{
    for (int garbage = 0; garbage < 2; garbage++) {
        memset(&it, garbage ? 0xA5 : 0, sizeof it);
        memset(&out, 0x11, sizeof out);
        if (@CALL@ != CAR_NOT_STARTED || !(@SILENT@))
            return 2;
        if (@START@ != CAR_OK || @CALL@ != CAR_OK || (@SILENT@))
            return 3;
    }
    return 0;
}
"""
FILTER = {
    "OBJECTS": "static car_estimator it;\nstatic car_sample in;\nstatic car_estimate out;\n"
    "static const double x[CAR_STATES] = CAR_START;",
    "CALL": "car_update(&it, &in, &out)",
    "SILENT": "out.state[0] != out.state[0] && out.state_std[CAR_STATES - 1] == INFINITY",
    "START": "car_start(&it, sizeof it, x)",
}
RECURSION = {
    "OBJECTS": "static car_recursion it;\nstatic double y[CAR_OUTPUTS], u[CAR_INPUTS];\nstatic car_estimate out;",
    "CALL": "car_update(&it, y, u, &out)",
    "SILENT": "out.theta[0][0] != out.theta[0][0] && out.noise[0][0] != out.noise[0][0]",
    "START": "car_start(&it, sizeof it)",
}
DRIVER = {
    "OBJECTS": "static car_driver it;\nstatic car_measurements in;\nstatic car_commands out;",
    "CALL": "car_step(&it, &in, &out)",
    "SILENT": "out.reason == CAR_LOST && out.wanted_v_x == 0 && out.value[0] == 0 && out.state_std[0] == INFINITY",
    "START": "car_start(&it, sizeof it)",
}
KINDS = {
    "filter": (lambda: test_estimators.VARIANTS["late, gate, offsets"], FILTER),
    "recursion": (lambda: started("directional, constant"), RECURSION),
    "moving horizon": (lambda: test_windows.VARIANTS["one state"], FILTER),
    "driver": (test_drivers.VARIANTS["plain"], DRIVER),
    "racer": (lambda: test_racers.racer(horizon=6), DRIVER),
}
FAST = ("filter", "recursion")


@needs_compiler
@pytest.mark.parametrize("kind", [k if k in FAST else pytest.param(k, marks=pytest.mark.slow) for k in KINDS])
def test_a_forgotten_start_is_said(kind, tmp_path):
    """Of memory that is zero, as static memory is, and of any other."""
    needs("gcc")
    made, words = KINDS[kind]
    project = project_of(made(), "car", 3)
    for file, content in project.everything.items():
        (tmp_path / file).write_text(content)
    text = PROGRAM
    for mark, word in words.items():
        text = text.replace(f"@{mark}@", word)
    (tmp_path / "use.c").write_text(text)
    run(
        "gcc",
        "-std=c99",
        "-O1",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-o",
        "use",
        *project.sources,
        "use.c",
        "-lm",
        folder=tmp_path,
    )
    run("./use", folder=tmp_path)
