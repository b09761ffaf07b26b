"""Tables against SciPy's splines, in C of columns, and in plans against a plain program with CasADi's own spline."""

import os

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PchipInterpolator, RectBivariateSpline, RegularGridInterpolator

from slipangle.codegen.expression import scalar_code
from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError
from slipangle.models.custom import Ode
from slipangle.models.lookup import LookupTable
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.program import source
from slipangle.optimal.terms import Limits, Weights

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler was found")

GRID = np.array([-2.0, -1.3, -0.2, 0.1, 0.9, 1.5, 3.0])
VALUES = np.array([1.0, -0.5, 0.2, 0.3, 2.0, 1.8, -1.0])
SECOND = np.array([0.0, 0.5, 0.7, 1.6, 2.0])
TABLE = np.random.default_rng(0).normal(size=(7, 5))
ORACLES = {
    "cubic": CubicSpline(GRID, VALUES),
    "monotone": PchipInterpolator(GRID, VALUES),
    "linear": lambda x, order=0: (
        np.interp(x, GRID, VALUES)
        if order == 0
        else (np.diff(VALUES) / np.diff(GRID))[np.searchsorted(GRID, x, "right") - 1]
    ),
}


def with_derivatives(table, n):
    x = ca.SX.sym("x", n)
    value = table(*(x[i] for i in range(n)))
    return ca.Function("table", [x], [value, ca.jacobian(value, x)])


@pytest.mark.parametrize("kind", ORACLES)
def test_values_and_slopes_are_those_of_scipy(kind):
    """Between and at grid points, on numbers, arrays and symbols."""
    table, oracle = LookupTable(GRID, VALUES, kind=kind), ORACLES[kind]
    x = np.concatenate([np.linspace(-1.99, 2.99, 101), GRID[:-1]])
    assert table(x) == pytest.approx(oracle(x), abs=1e-13)
    symbolic = with_derivatives(table, 1)
    for v in x:
        value, slope = symbolic(v)
        assert float(table(v)) == pytest.approx(float(oracle(v)), abs=1e-13)
        assert float(value) == pytest.approx(float(oracle(v)), abs=1e-13)
        assert float(slope) == pytest.approx(float(oracle(v, 1)), abs=1e-12)


@pytest.mark.parametrize("kind", ["cubic", "linear"])
def test_two_axes_are_those_of_scipy(kind):
    table, rng = LookupTable((GRID, SECOND), TABLE, kind=kind), np.random.default_rng(1)
    spline, straight = RectBivariateSpline(GRID, SECOND, TABLE), RegularGridInterpolator((GRID, SECOND), TABLE)

    def oracle(x, y):
        return spline.ev(x, y) if kind == "cubic" else straight(np.column_stack([x, y]))

    x, y = rng.uniform(-2.0, 3.0, 100), rng.uniform(0.0, 2.0, 100)
    assert table(x, y) == pytest.approx(oracle(x, y), abs=1e-12)
    symbolic = with_derivatives(table, 2)
    for a, b in zip(x[:20], y[:20], strict=True):
        value, slope = symbolic([a, b])
        assert float(value) == pytest.approx(oracle(a, b).item(), abs=1e-12)
        if kind == "cubic":
            assert np.asarray(slope).ravel() == pytest.approx(
                [spline.ev(a, b, 1, 0).item(), spline.ev(a, b, 0, 1).item()], abs=1e-11
            )


@pytest.mark.parametrize("kind", ["cubic", "linear", "monotone"])
def test_beyond_the_grid_it_holds_or_goes_straight_on(kind):
    held, line = (LookupTable(GRID, VALUES, kind=kind, outside=o) for o in ("hold", "line"))
    for x, end in ((-3.5, 0), (4.5, -1)):
        inner = GRID[end] + (1e-9 if end == 0 else -1e-9)
        slope = float(ORACLES[kind](inner, 1))
        assert float(held(x)) == pytest.approx(VALUES[end], rel=1e-13)
        assert float(line(x)) == pytest.approx(VALUES[end] + slope * (x - GRID[end]), rel=1e-7)
        assert float(with_derivatives(held, 1)(x)[1]) == 0.0
        assert float(with_derivatives(line, 1)(x)[1]) == pytest.approx(slope, rel=1e-7)
    plane = LookupTable((GRID, SECOND), TABLE, kind="linear", outside="line")
    assert float(plane(1.0, 3.0)) == pytest.approx(3.5 * float(plane(1.0, 2.0)) - 2.5 * float(plane(1.0, 1.6)))


@pytest.mark.parametrize("outside", ["hold", "line"])
def test_what_is_no_number_stays_so(outside):
    table = LookupTable(GRID, VALUES, outside=outside)
    assert np.isnan(table(np.nan))
    assert np.isnan(float(with_derivatives(table, 1)(np.nan)[0]))


MOTOR = LookupTable([0.0, 0.4, 0.8, 1.2, 2.0, 3.0], [1.0, 0.95, 0.7, 0.4, 0.2, 0.1])
DRAG = LookupTable((np.linspace(-3, 3, 7), [-1.0, 0.0, 1.0]), np.outer(np.linspace(-1, 1, 7) ** 3, [0.5, 1.0, 1.4]))


def driven(**settings):
    """A mass whose push falls with speed and whose drag depends on speed and place."""
    return Ode(
        f=lambda x, u, p: [x[1], p.gain * MOTOR(x[1]) * u[0] - DRAG(x[1], x[0])],
        states=("s", "v"),
        inputs=("a",),
        params={"gain": (1.5, 0.1, 5.0)},
        dt=0.1,
        substeps=1,
        **settings,
    )


def plain(x0, wanted, n):
    """The same by Ipopt on CasADi's own B-splines, one Runge-Kutta step per stage."""
    motor = ca.interpolant("motor", "bspline", [MOTOR.grid[0].tolist()], MOTOR.values.tolist())
    flat = {"degree": [3, 2]}
    drag = ca.interpolant(
        "drag", "bspline", [a.tolist() for a in DRAG.grid], DRAG.values.ravel(order="F").tolist(), flat
    )
    u, x, cost = ca.MX.sym("u", n), ca.MX(ca.DM(x0)), 0

    def rate(x, a):
        return ca.vertcat(x[1], 1.5 * motor(x[1]) * a - drag(ca.vertcat(x[1], x[0])))

    for k in range(n):
        cost += 5.0 * (x[0] - wanted) ** 2 + 0.1 * x[1] ** 2 + 0.05 * u[k] ** 2
        k1 = rate(x, u[k])
        k2 = rate(x + 0.05 * k1, u[k])
        k3 = rate(x + 0.05 * k2, u[k])
        k4 = rate(x + 0.1 * k3, u[k])
        x = x + 0.1 / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    cost += 5.0 * (x[0] - wanted) ** 2 + 0.1 * x[1] ** 2
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-13, "bound_relax_factor": 0.0}}
    found = ca.nlpsol("plain", "ipopt", {"x": u, "f": cost}, options)(x0=0.0, lbx=-1.0, ubx=1.0)
    return float(found["f"]), np.asarray(found["x"]).ravel()


@pytest.mark.parametrize("solver", ["condensed", pytest.param("riccati", marks=pytest.mark.slow), "ipopt"])
def test_plans_are_those_of_a_plain_program(solver):
    engine = Ipopt(tolerance=1e-13) if solver == "ipopt" else RealTime(iterations=0, tolerance=1e-11, qp=solver)
    mpc = MPC(driven(), horizon=10, Q=Weights(s=5.0, v=0.1), R=Weights(a=0.05), limits=Limits(a=1.0), solver=engine)
    plan = mpc.plan(np.array([0.0, 0.25]), s=0.6, v=0.0)
    cost, u = plain([0.0, 0.25], 0.6, 10)
    assert plan.status.solved
    assert plan.cost == pytest.approx(cost, rel=1e-9)
    assert plan.u[:, 0] == pytest.approx(u, abs=1e-8)


def test_the_code_has_no_branches_and_is_that_of_columns():
    mpc = MPC(driven(), horizon=4, Q=Weights(s=1.0), R=Weights(a=1.0))
    assert "#define DYNAMICS EXPLICIT" in source(mpc.ocp)
    code = scalar_code(mpc.ocp.dynamics)
    assert code is not None
    assert driven().recorded().step([0.1, 0.3], [0.4]) == pytest.approx(driven().step([0.1, 0.3], [0.4]), rel=1e-14)


@pytest.mark.filterwarnings("ignore:no C compiler")
@pytest.mark.parametrize("compiler", ["", "none"])
def test_an_interpolant_of_casadi_plans_alike_but_not_in_columns(monkeypatch, compiler):
    monkeypatch.setenv("SLIPANGLE_CC", compiler or os.environ.get("SLIPANGLE_CC", ""))
    spline = ca.interpolant("spline", "bspline", [MOTOR.grid[0].tolist()], MOTOR.values.tolist())
    plans = []
    for table in (MOTOR, lambda v: spline(v) if isinstance(v, (ca.SX, ca.MX)) else np.asarray(spline(v)).ravel()[0]):
        model = Ode(
            f=lambda x, u, p, t=table: [x[1], t(x[1]) * u[0]], states=("s", "v"), inputs=("a",), params={}, dt=0.1
        )
        mpc = MPC(model, horizon=6, Q=Weights(s=5.0), R=Weights(a=0.1), solver=RealTime(iterations=0))
        assert ("#define DYNAMICS EXPLICIT" in source(mpc.ocp)) == (table is MOTOR)
        plans.append(mpc.plan(np.array([0.0, 0.3]), s=0.4))
    assert plans[1].u == pytest.approx(plans[0].u, abs=1e-8)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((GRID, VALUES[:-1]), r"values of shape \(6,\)"),
        ((GRID[::-1], VALUES), "does not rise"),
        ((GRID, VALUES, "qubic"), "cubic"),
        ((GRID, VALUES, "cubic", "extrapolate"), "hold"),
        (((GRID, SECOND), TABLE, "monotone"), "one axis"),
        (([0.0], [1.0]), "two or more points"),
        ((GRID, np.full(7, np.nan)), "finite value"),
        (("a", "b"), "two or more points"),
    ],
)
def test_what_makes_no_sense_is_said(given, words):
    with pytest.raises(ParameterError, match=words):
        LookupTable(*given)


def test_as_many_arguments_as_axes():
    with pytest.raises(ParameterError, match="one per axis"):
        LookupTable(GRID, VALUES)(1.0, 2.0)
