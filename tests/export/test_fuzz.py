"""Sanitizers have nothing to say of any kind of export, whatever it is given."""

from pathlib import Path

import pytest

from slipangle.export.kinds import project_of
from slipangle.export.precision import as_precision
from tests.control.marx.test_mpc import BY_POSE
from tests.export import (
    test_drivers,
    test_estimators,
    test_followers,
    test_joined,
    test_marx_learns,
    test_racers,
    test_sensors,
    test_switched,
    test_widths,
    test_windows,
)
from tests.export.test_mpc import controller
from tests.export.test_recursions import started
from tests.export.tools import needs, run
from tests.models.all_models import ALL_MODELS

KINDS = {  # what it is, columns of its drive before its inputs, how many of what comes out must be finite
    "MPC": (lambda: controller(6), 0, "RACER_CONTROLS", 100_000),
    "MPC with scenarios": (test_joined.KINDS["a corridor at two speeds"], 0, "RACER_CONTROLS", 100_000),
    "MPC, implicit wheels": (lambda: test_widths.controller(6), 0, "RACER_CONTROLS", 100_000),
    "MARX": (lambda: BY_POSE, 0, "RACER_CONTROLS", 100_000),
    "MARX that learns": (lambda: test_marx_learns.INTEGRAL, 0, "RACER_CONTROLS", 100_000),
    "switched": (lambda: test_switched.KINDS["MARX with offsets"], 0, "RACER_CONTROLS", 100_000),
    "Stanley": (lambda: test_followers.KINDS["Stanley"], 0, "RACER_CONTROLS", 100_000),
    "pure pursuit": (lambda: test_followers.KINDS["pure pursuit"], 0, "RACER_CONTROLS", 100_000),
    "LQR with preview": (lambda: test_followers.KINDS["LQR with preview"], 0, "RACER_CONTROLS", 100_000),
    "compensated": (lambda: test_followers.KINDS["Stanley, compensated"], 0, "RACER_CONTROLS", 100_000),
    "driver": (test_drivers.VARIANTS["plain"], 1, "RACER_COMMANDS", 100_000),
    "driver, late, lagged, pedals": (test_drivers.VARIANTS["late, lagged, pedals"], 1, "RACER_COMMANDS", 100_000),
    "racer": (lambda: test_racers.racer(horizon=6), 1, "RACER_COMMANDS", 20_000),
    "racer, late": (lambda: test_racers.racer(horizon=6, **test_racers.LATE), 1, "RACER_COMMANDS", 20_000),
    "estimator": (lambda: test_estimators.VARIANTS["late, gate, offsets"], 0, "RACER_STATES", 100_000),
    "moving horizon": (lambda: test_windows.VARIANTS["late, gate, offsets"], 0, "RACER_STATES", 100_000),
    "driver that looks back": (test_windows.driver, 1, "RACER_COMMANDS", 100_000),
    "recursion": (lambda: started("directional, constant"), 0, "0", 100_000),
    "virtual sensor": (lambda: test_sensors.LEARNED, 0, "0", 100_000),
    "model": (lambda: ALL_MODELS["saturating bicycle"], "RACER_STATES", "0", 100_000),
    "tires": (lambda: ALL_MODELS["single track, Magic Formula"], "RACER_STATES", "0", 100_000),
    "network": (lambda: ALL_MODELS["NARX"], "RACER_STATES", "0", 100_000),
    "dual track": (lambda: ALL_MODELS["dual track, front drive"], "RACER_STATES", "0", 100_000),
}
SANITIZERS = {
    "address, undefined": ("gcc", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"),
    "memory": ("clang", "-fsanitize=memory"),
}
TEN_THOUSANDS = [pytest.param(k, marks=pytest.mark.slow) for k in KINDS if k not in ("Stanley", "model")]


@pytest.mark.parametrize("precision", ["double", pytest.param("single", marks=pytest.mark.slow)])
@pytest.mark.parametrize("sanitizer", SANITIZERS)
@pytest.mark.parametrize("kind", ["Stanley", "model", *TEN_THOUSANDS])
def test_sanitizers_have_nothing_to_say(kind, sanitizer, precision, tmp_path):
    """Of 100 000 random inputs, a third of which hold NaN, infinities and what no sensor says."""
    command = SANITIZERS[sanitizer]
    needs(command[0])
    thing, before, finite, calls = KINDS[kind]
    project = as_precision(project_of(thing(), "racer", 200), precision)
    for file, content in project.everything.items():
        (tmp_path / file).write_text(content)
    sources = [s.replace("car", "racer") for s in project.sources]
    here = Path(__file__).parent / "fuzz_block.c"
    given = ("-std=c99", "-O1", "-g", "-march=native", "-I.", f"-DSKIP={before}", f"-DCOMMANDS={finite}")
    run(*command, *given, "-o", "fuzz", *sources, here, "-lm", folder=tmp_path)
    said = run("./fuzz", str(calls), folder=tmp_path, stdin=tmp_path / "drive.csv", limit=1200)
    assert said == f"{calls} calls, 0 commands that are none\n"
