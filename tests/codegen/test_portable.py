"""Every kind of C that the toolbox writes for itself compiles for other systems too."""

from importlib.resources import files

import numpy as np
import pytest

from slipangle.control.marx.solver import source as marx_source
from slipangle.identify.linear import recursive_code
from slipangle.identify.physics import forward_code
from slipangle.models.black_box import arx_code
from slipangle.models.vehicles import neural_bicycle_code
from slipangle.models.vehicles.dual_track import kernel
from slipangle.optimal.realtime.program import source as solver_source
from slipangle.simulate.compiled import source as loop_source
from tests.control.marx.test_mpc import BY_POSE
from tests.export.test_mpc import controller
from tests.export.tools import ZIG, needs, run
from tests.models.all_models import ALL_MODELS

TARGETS = ("x86_64-windows-gnu", "aarch64-macos", "aarch64-linux-musl", "arm-linux-musleabihf", "wasm32-wasi")


def recursion():
    """C of recursive least squares, which is compiled where it is made."""
    seen = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recursive_code, "library", lambda source, **_: seen.append(source))
        how = {"memory": 2, "forgetting": 0.99, "threshold": 0.0, "directional": True}
        recursive_code.Recursion((0, 1, 2), np.ones(3), (1, 1, 2, 2), **how)
    return seen[0]


KINDS = {
    "solver": lambda: solver_source(controller(4).ocp),
    "MARX": lambda: marx_source(BY_POSE.problem),
    "recursive least squares": recursion,
    "ARX": arx_code.source,
    "NARX": lambda: ALL_MODELS["NARX"].source(),
    "neural state space": lambda: ALL_MODELS["neural state space"].source(),
    "neural bicycle": lambda: neural_bicycle_code.source(ALL_MODELS["neural bicycle"]),
    "dual track": lambda: kernel.source(ALL_MODELS["dual track, front drive"]),
    "free runs with sensitivities": lambda: forward_code.code_of(ALL_MODELS["bicycle"], ("C_f", "C_r")).run,
    "drives with a delay": lambda: forward_code.code_of(ALL_MODELS["bicycle with late steering"], ("C_f",)).drive,
    "loop": loop_source,
    "paths": lambda: (files("slipangle.paths") / "line.c").read_text(encoding="utf-8"),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("target", TARGETS)
def test_compiles_for(target, kind, tmp_path):
    needs("zig")
    source = KINDS[kind]()
    assert source.count("{") > 5
    (tmp_path / "own.c").write_text(source)
    run(*ZIG, "-target", target, "-O1", "-std=gnu11", "-fno-sanitize=undefined", "-c", "own.c", folder=tmp_path)
    assert any(p.suffix in (".o", ".obj") for p in tmp_path.iterdir())
