"""What exported code answers where its start was forgotten: that, and nothing that could be taken for an estimate."""

import pytest

from slipangle.codegen import compiler
from slipangle.export.controllers import base_of, limits_of
from slipangle.export.kinds import project_of
from tests.control.marx.test_mpc import BY_POSE
from tests.export import (
    test_drivers,
    test_estimators,
    test_followers,
    test_joined,
    test_marx_learns,
    test_mpc,
    test_racers,
    test_sensors,
    test_switched,
    test_windows,
)
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
        if (@START@ != CAR_OK || !(@FIRST@) || @CALL@ != @GOES_ON@ || (@SILENT@))
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
    "OBJECTS": "static car_driver it;\nstatic car_measurements in;\nstatic car_commands out;\n"
    "static int late(double t) { int code; in.t = t, code = car_step(&it, &in, &out), in.t = 0; return code; }",
    "CALL": "car_step(&it, &in, &out)",
    "SILENT": "out.reason == CAR_LOST && out.wanted_v_x == 0 && out.value[0] == 0 && out.state_std[0] == INFINITY",
    "FIRST": "late(NAN) == CAR_WRONG_TIME && (@SILENT@)",
    "START": "car_start(&it, sizeof it)",
}
RACER = DRIVER | {
    "OBJECTS": DRIVER["OBJECTS"]
    + "static int learned(void) { car_learned to; car_learned_by_now(&it, &to); return to.grip != 0; }",
    "START": "(learned() ? -1 : car_start(&it, sizeof it))",
    "FIRST": DRIVER["FIRST"] + " && learned()",
}
SENSOR = {
    "OBJECTS": "static car_sensor it;\nstatic double channels[CAR_CHANNELS];\nstatic car_estimate out;",
    "CALL": "car_update(&it, channels, &out)",
    "SILENT": "out.v_y != out.v_y && out.side_slip != out.side_slip && car_update(&it, channels, &out) != CAR_SILENT",
    "START": "car_start(&it, sizeof it)",
    "GOES_ON": "CAR_SILENT",
}
STAYS = """
/* Whether all inputs are what was applied, within limits. */
static int stays(double applied, double wanted)
{
    in.applied[0] = applied, in.applied_known = 1;
    int all = car_plan(&it, &in, &out) == CAR_NOT_STARTED && out.status == CAR_NOT_STARTED && out.health.plans == 0;
    for (int i = 0; i < CAR_HORIZON; i++)
        all &= fabs(out.u[i][0] - wanted) < 1e-12;
    return all && fabs(out.command[0] - wanted) < 1e-12 && out.age == 1 && out.stopping;
}
"""
CONTROLLER = {
    "OBJECTS": "static car_controller it;\nstatic car_input in;\nstatic car_output out;\n" + STAYS,
    "CALL": "car_plan(&it, &in, &out)",
    "SILENT": "stays(0.01, 0.01) && stays(-1e9, -@LIMIT@) && stays(NAN, 0) && out.cost != out.cost",
    "START": "car_start(&it, sizeof it)",
    "GOES_ON": "out.status",
}
KINDS = {
    "MPC": (lambda: test_mpc.controller(4), CONTROLLER),
    "scenarios": (test_joined.KINDS["a corridor at two speeds"], CONTROLLER),
    "MARX-MPC": (lambda: BY_POSE, CONTROLLER),
    "MARX that learns": (lambda: test_marx_learns.INTEGRAL, CONTROLLER),
    "switched": (lambda: test_switched.SWITCHED, CONTROLLER),
    "path follower": (lambda: test_followers.KINDS["Stanley"], CONTROLLER),
    "compensated": (lambda: test_followers.KINDS["Stanley, compensated"], CONTROLLER),
    "virtual sensor": (lambda: test_sensors.LEARNED, SENSOR),
    "filter": (lambda: test_estimators.VARIANTS["late, gate, offsets"], FILTER),
    "recursion": (lambda: started("directional, constant"), RECURSION),
    "moving horizon": (lambda: test_windows.VARIANTS["one state"], FILTER),
    "driver": (test_drivers.VARIANTS["plain"], DRIVER),
    "racer": (lambda: test_racers.racer(horizon=6), RACER),
}
FAST = ("filter", "recursion", "MPC", "path follower", "virtual sensor")


@needs_compiler
@pytest.mark.parametrize("kind", [k if k in FAST else pytest.param(k, marks=pytest.mark.slow) for k in KINDS])
def test_a_forgotten_start_is_said(kind, tmp_path):
    """Of memory that is zero, as static memory is, and of any other."""
    needs("gcc")
    made, words = KINDS[kind]
    thing = made()
    project = project_of(thing, "car", 3)
    words = {"GOES_ON": "CAR_OK", "FIRST": "1", **words}
    if words["OBJECTS"] is CONTROLLER["OBJECTS"]:
        words["LIMIT"] = repr(limits_of(base_of(thing))[thing.controls[0]][1])
    for file, content in project.everything.items():
        (tmp_path / file).write_text(content)
    text = PROGRAM
    for mark, word in sorted(words.items(), key=lambda each: (each[0] == "LIMIT", each)):  # the first may have others
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
