"""Chapter 7: the pieces do what they say; whole tables in the slow run."""

import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.models.tires.simple import LinearTire
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime
from slipangle.reproduce import _chapter_7 as c7
from slipangle.reproduce import find, names
from slipangle.reproduce._cvodes import ByCvodes
from slipangle.reproduce.table_7_1 import choose, search

needs_compiler = pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
X0 = np.array([0.2, 0.1, 3.0, 1.0, 0.05])
U = np.array([0.03, 15.0])


def test_they_are_experiments():
    assert {"table-7.1", "table-7.4", "table-7.5", "table-7.6"} <= set(names())


def test_eq_7_1_with_linear_tires_is_the_bicycle_at_small_angles():
    p = SOUSA_TABLE_7_2
    tires = LinearTire(C_alpha=0.5 * p.C_f), LinearTire(C_alpha=0.5 * p.C_r)
    ours = c7.Lateral(params=p, tire_f=tires[0], tire_r=tires[1], dt=0.01, substeps=4)
    other = OnGround(Bicycle(params=p, dt=0.01, outputs=("v_y", "r")))
    x, y = X0 * 0.1, X0 * 0.1
    for _ in range(50):
        x, y = ours.step(x, U * [0.1, 1.0]), other.step(y, U * [0.1, 1.0])
    assert x == pytest.approx(y, rel=2e-3, abs=1e-5)


def test_eq_7_1_agrees_with_cvodes():
    model = c7.magic_model()
    assert ByCvodes(model).step(X0, U) == pytest.approx(model.step(X0, U), rel=2e-3, abs=1e-4)


def test_the_path_has_the_segments_as_stated():
    path = c7.the_path()
    for (low, high), v in zip(c7.SEGMENTS.values(), (11.0, 20.0, 15.0), strict=True):
        inside = (path.X > low + 30) & (path.X < min(high, path.X[-1]) - 35)
        assert np.median(path.v_x[inside]) == pytest.approx(v, abs=0.5)
    assert path.v_x.min() >= 10.0
    assert path.v_x.max() <= 20.0


@needs_compiler
def test_ipopt_and_the_compiled_solver_agree_on_lmpc():
    p = SOUSA_TABLE_7_2
    tire = LinearTire(C_alpha=6e4)
    model = c7.Lateral(params=p, tire_f=tire, tire_r=tire, dt=c7.STEP, substeps=2)
    look = c7.the_path().ahead(100.0, c7.HORIZON, c7.STEP)
    x = np.array([0.0, 0.1, look.X[0], look.Y[0] + 0.1, look.psi[0]])
    found = []
    for solver in (Ipopt(tolerance=1e-9), RealTime(iterations=0)):
        mpc = c7.general(model, solver)
        found.append(mpc.plan(x, mpc.reference(look)).u)
    assert found[0] == pytest.approx(found[1], abs=1e-5)


@needs_compiler
def test_one_speed_of_table_7_1_meets_its_bounds():
    found = search(c7.sine_log(20.0))
    best = choose(found)
    assert best.validation.rmse <= 1.231
    assert best.validation.r2 >= 0.998
    assert best.model.na + best.model.nb <= 5
    assert np.sort(np.abs(best.model.poles))[-2:] == pytest.approx([1.0, 1.0], abs=1e-4)


@needs_compiler
def test_logs_excite_and_models_hold_on_another_log():
    from slipangle.identify.judge.validate import score

    model = c7.planar_arx(15.0)
    other = c7.rich_log(15.0, seed=9, duration=15.0).select(inputs=("delta",), outputs=("v_y", "r"))
    run = model.simulate(other)
    assert min(score(run, n).r2 for n in ("v_y", "r")) > 0.995
    assert np.abs(model.poles).max() < 0.95


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", ["table-7.1", "table-7.4", "table-7.5", "table-7.6"])
def test_whole_tables_hold(name):
    assert find(name).reproduce(lambda share, what: None).holds
