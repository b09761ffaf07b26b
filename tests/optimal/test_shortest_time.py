"""The shortest time of a car whose engine is a measured table, beside a quadrature of it with SciPy's own spline.

With one control and nothing priced but the time, full throttle and then full brakes are best, so that the time is that
of an ordinary differential equation.
"""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.optimal.solution import Plan

MASS, DRAG, BRAKES, FASTEST = 1400.0, 0.6, 8.0, 60.0  # kg, kg/m, m/s2 and m/s
SPEEDS = np.array([0.0, 8.0, 15.0, 25.0, 40.0, 60.0])  # m/s
DRIVES = np.array([6.0, 7.2, 6.5, 4.6, 3.1, 2.0]) * 1e3  # N
LENGTH = 150.0  # m


def shortest(kind: str, *, stops: bool) -> Plan:
    """The plan from 3 m/s over `LENGTH`, to a standstill or not."""
    drive = sa.LookupTable(SPEEDS, DRIVES, kind=kind)

    def f(x, u, p):
        return [x[1], u[0] * drive(x[1]) / p.mass - u[1] * BRAKES - DRAG * x[1] * x[1] / p.mass]

    car = sa.Ode(f=f, states=("s", "v"), inputs=("pedal", "brake"), params={"mass": MASS}, dt=0.1)
    mpc = sa.MPC(
        car,
        horizon=20,
        controls=("pedal", "brake"),
        terminal=sa.Weights(duration=1.0),
        Q={},
        R=sa.Weights(pedal=1e-7, brake=1e-7),
        limits=sa.Limits(pedal=(0.0, 1.0), brake=(0.0, 1.0), v=(0.0, FASTEST)),
        terminal_limits=sa.Limits(s=(LENGTH, LENGTH), **({"v": (0.0, 0.0)} if stops else {})),
        duration=(1.0, 30.0),
        solver=sa.RealTime(iterations=0, hessian="exact"),
    )
    return mpc.plan(np.array([0.0, 3.0]))


def oracle(kind: str, *, stops: bool) -> float:
    """Time over `LENGTH` in s: integrals over the speed of mass over force, on full throttle and on full brakes."""
    drive = CubicSpline(SPEEDS, DRIVES) if kind == "cubic" else lambda v: np.interp(v, SPEEDS, DRIVES)

    def gains(v: float) -> float:
        return (drive(v) - DRAG * v * v) / MASS

    def loses(v: float) -> float:
        return BRAKES + DRAG * v * v / MASS

    def over(top: float, power: int) -> float:
        """Time (0) or way (1) up to a speed, and down from it where the car stops."""
        seen = SPEEDS[(SPEEDS > 3.0) & (SPEEDS < top)]
        up = quad(lambda v: v**power / gains(v), 3.0, top, points=seen, limit=200, epsabs=1e-12)[0]
        return up + (quad(lambda v: v**power / loses(v), 0.0, top, epsabs=1e-12)[0] if stops else 0.0)

    top = brentq(lambda v: over(v, 1) - LENGTH, 4.0, 55.0, xtol=1e-12)
    return over(top, 0)


@pytest.mark.skipif(compiler() is None, reason=sentence())
@pytest.mark.parametrize(("kind", "stops"), [("cubic", False), ("linear", True)])
def test_it_is_that_of_full_throttle_and_full_brakes(kind, stops):
    plan = shortest(kind, stops=stops)
    assert plan.status.solved, plan.message
    took, best = plan.decided["duration"], oracle(kind, stops=stops)
    if stops:  # the change to brakes is within a stage, whose pedals are held
        assert best - 1e-5 < took < 1.002 * best
    else:
        assert took == pytest.approx(best, rel=2e-5)
