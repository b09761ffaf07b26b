"""What an exported MPC decides does not hang on how many numbers the processor's vectors hold."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.export.kinds import project_of
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from tests.export.loaded import Loaded

QUICK = "3 stages"
KINDS = {  # steps of the model: with and without a lane of eight, four and two to spare
    QUICK: {"horizon": 3},
    "10 stages": {"horizon": 10},
    "12 stages": {"horizon": 12},
    "8 stages": {"horizon": 8},
    "13 stages": {"horizon": 13},
    "12 steps in 5 stages": {"horizon": 5, "steps": (1, 1, 2, 3, 5)},
    "two iterations": {"horizon": 6, "solver": sa.RealTime(iterations=2)},
}


def controller(horizon, **settings):
    model = sa.SingleTrack(
        params=SOUSA_TABLE_6_1, dt=0.1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2, method="radau"
    )
    return sa.MPC(
        model,
        horizon=horizon,
        Q=sa.Weights(v_x=1.0, Y=1.0, psi=10.0),
        S=sa.Weights(delta=100.0, T_f=1e-5),
        limits=sa.Limits(delta=0.35, T_f=1500.0),
        **settings,
    )


@pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
@pytest.mark.parametrize("kind", [k if k == QUICK else pytest.param(k, marks=pytest.mark.slow) for k in KINDS])
def test_plans_of_implicit_models_are_those_of_other_vectors(kind, monkeypatch):
    """Over a drive with jumps of the state, steps that need many shorter ones and lost measurements among it."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0")
    mpc = controller(**KINDS[kind])
    files, exported = project_of(mpc, "car", 2).everything, {}
    for lanes in (8, 1) if kind == QUICK else (8, 4, 2, 1):
        monkeypatch.setenv("SLIPANGLE_CFLAGS", f"-O0 -DCAR_LANES={lanes}")
        exported[lanes] = Loaded(files)
    path, rng = sa.double_lane_change(20.0, blend=12.0), np.random.default_rng(3)
    x, s, seen = mpc.model.straight(19.0, X=path.start[0]), 0.0, set()
    for k in range(30 if kind == QUICK else 60):
        foot = path.project(x[5], x[6], s)
        s = foot.s
        given = np.array(x)
        if k % 9 == 5:
            given = given + rng.normal(size=len(x)) * np.where(np.abs(x) > 1, 0.03 * np.abs(x), 0.03)
        if k % 20 == 11:
            given[3:5] *= 0.2
        if k % 17 == 9:
            given[0] = np.nan
        reference = mpc.reference(path.ahead(s, mpc.times), T_r=0.0)
        plans = {lanes: made.plan(given, reference) for lanes, made in exported.items()}
        wanted = plans[8]
        seen.add(wanted.status)
        for lanes, plan in plans.items():
            assert plan.status == wanted.status, (k, lanes)
            off = np.abs(np.array(plan.command) - wanted.command) / (1 + np.abs(wanted.command))
            assert off.max() <= 1e-10, (k, lanes, off)
        x = np.asarray(mpc.model.step(x, np.array([*wanted.command, 0.0])))
    assert len(seen) > 1
