"""Metrics, units, path geometry and path errors against `tests.oracles.measures`."""

import numpy as np
import pytest

from slipangle.errors import ParameterError
from slipangle.identify.judge import metrics
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.vehicles.kinematic import Kinematic
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.ocp import OCP, Weights
from slipangle.paths.centreline import limit_rise
from slipangle.paths.path import Path
from slipangle.units import _UNITS, deg, from_si, kmh, to_si
from tests.oracles import measures
from tests.oracles.compare import uniform

# ---- metrics --------------------------------------------------------------------------------------------------------

RECORDS = {
    "noisy": (0.0, 0.2),
    "biased": (0.7, 0.05),  # tells VAF, which does not see the offset, from R2, which does
    "worse than the mean": (3.0, 2.0),
}


@pytest.mark.parametrize(("bias", "noise"), RECORDS.values(), ids=RECORDS.keys())
@pytest.mark.parametrize("name", ["rmse", "r2", "fit", "vaf"])
def test_metrics(name, bias, noise):
    rng = np.random.default_rng(0)
    y = np.cumsum(rng.standard_normal((150, 2)), axis=0) * [1.0, 30.0] + [5.0, -200.0]
    y_hat = y + [1.0, 30.0] * (bias + noise * rng.standard_normal((150, 2)))
    wanted = [getattr(measures, name)(y[:, i].tolist(), y_hat[:, i].tolist()) for i in (0, 1)]
    np.testing.assert_allclose(getattr(metrics, name)(y, y_hat), wanted, rtol=1e-10)


def test_a_constant_offset_costs_fit_and_r2_but_no_vaf():
    y = np.sin(np.arange(100) / 7)
    assert metrics.vaf(y, y + 0.5) == pytest.approx(100.0, abs=1e-9)
    assert metrics.r2(y, y + 0.5) == pytest.approx(1 - 0.25 / np.var(y), rel=1e-12)
    assert metrics.fit(y, y + 0.5) == pytest.approx(100 * (1 - 0.5 / np.std(y)), rel=1e-12)
    assert metrics.fit(y, np.full(100, y.mean())) == pytest.approx(0.0, abs=1e-9)


# ---- units ----------------------------------------------------------------------------------------------------------


def test_every_unit_has_the_size_of_its_definition():
    one = {name for name, (_, si, factor) in _UNITS.items() if factor == 1.0 and name == si}
    temperatures = {"degC", "K", "degF"}  # which have zeros of their own
    assert not set(_UNITS) - one - temperatures - measures.UNITS.keys(), (
        "give new units a size in tests.oracles.measures too"
    )
    for name, size in measures.UNITS.items():
        assert to_si(3.0, name) == pytest.approx(3.0 * size, rel=1e-12), name
        assert from_si(to_si(3.0, name), name) == pytest.approx(3.0, rel=1e-12), name
    for name, cold, hot in (("degC", 0.0, 100.0), ("K", 273.15, 373.15), ("degF", 32.0, 212.0)):  # ice and steam
        assert to_si(np.array([cold, hot]), name) == pytest.approx([0.0, 100.0], abs=1e-9)
        assert from_si(np.array([0.0, 100.0]), name) == pytest.approx([cold, hot], rel=1e-12)
    assert deg(90.0) == pytest.approx(np.pi / 2, rel=1e-15)
    assert kmh(36.0) == pytest.approx(10.0, rel=1e-15)


# ---- paths ----------------------------------------------------------------------------------------------------------


def ring(a=60.0, b=35.0):
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    return Path.from_points(a * np.cos(t), b * np.sin(t), closed=True)


def test_heading_and_curvature_of_an_ellipse_to_the_left():
    path = ring()
    t = np.arctan2(path.Y / 35.0, path.X / 60.0)
    X, Y, psi, curvature = measures.ellipse(60.0, 35.0, t)
    assert np.hypot(path.X - X, path.Y - Y).max() < 1e-5
    assert np.abs(np.angle(np.exp(1j * (path.psi - psi)))).max() < 1e-5
    np.testing.assert_allclose(path.curvature, curvature, rtol=1e-3)
    assert path.psi[-1] - path.psi[0] == pytest.approx(2 * np.pi, abs=1e-6)
    right = Path.from_points(path.X[::-1], path.Y[::-1], closed=True)
    assert (right.curvature < 0).all()


@pytest.mark.parametrize("side", [-4.0, 2.5])
def test_distance_is_positive_to_the_left(side):
    """From the point of an ellipse along its normal, to the left of driving: inwards."""
    path = ring()
    for t in np.linspace(-3, 3, 13):
        X, Y, psi, _ = measures.ellipse(60.0, 35.0, t)
        foot = path.project(X - side * np.sin(psi), Y + side * np.cos(psi))
        at = path.at(foot.s)
        assert foot.e_y == pytest.approx(side, abs=1e-4)
        assert np.hypot(at.X[0] - X, at.Y[0] - Y) < 1e-3
        assert np.angle(np.exp(1j * (foot.psi - psi))) == pytest.approx(0.0, abs=1e-4)


def test_edges_of_the_lane_lie_on_their_sides():
    path = ring()
    lane = Path.from_points(path.X[:-1:4], path.Y[:-1:4], closed=True, left=3.0, right=1.5)
    right, left = lane.boundaries()
    for k in range(0, len(lane.s) - 1, 60):
        foot = (lane.X[k], lane.Y[k], lane.psi[k])
        assert measures.seen_from_the_path(*left[k], 0.0, foot)[:2] == pytest.approx([0.0, 3.0], abs=1e-9)
        assert measures.seen_from_the_path(*right[k], 0.0, foot)[:2] == pytest.approx([0.0, -1.5], abs=1e-9)
    middle, psi = np.array([lane.X[40], lane.Y[40]]), lane.psi[40]
    to_left = np.array([-np.sin(psi), np.cos(psi)])
    for offset, fits in ((0.0, True), (1.9, True), (2.1, False), (-0.4, True), (-0.6, False)):
        assert lane.inside(*(middle + offset * to_left), 2.0)[0] == fits, offset


def test_speed_profile_uses_all_that_the_friction_ellipse_leaves():
    h, n, k, a_y = 0.02, 6000, 1 / 80, 7.0
    top = np.full(n, np.sqrt(a_y / k))
    top[0] = 3.0
    found = limit_rise(top, np.full(n, k), h, a_y, 4.0, 1, closed=False)
    wanted = measures.fastest_in_a_bend(h * np.arange(n), 3.0, k, a_y, 4.0)
    assert 90.0 < h * np.argmax(wanted > 0.999 * wanted.max()) < 110.0  # of 120 m: both parts count
    np.testing.assert_allclose(found, wanted, rtol=2e-3)


def test_errors_that_a_controller_minimises():
    """e_x ahead, e_y to the left, e_psi turned to the left of the reference pose."""
    problem = OCP(
        Kinematic(params=SOUSA_TABLE_7_2, dt=0.05),
        horizon=3,
        controls=("delta",),
        Q=Weights(e_x=1.0, e_y=1.0, e_psi=1.0),
    )
    names = problem.references
    for pose, foot in zip(
        uniform(0, 50, (-9, 9), (-9, 9), (-3, 3)), uniform(1, 50, (-9, 9), (-9, 9), (-3, 3)), strict=True
    ):
        turned = pose[2] * 0.4 - foot[2]  # less than half a turn: the controller does not wrap
        if abs(turned) > 3:
            continue
        x = np.array([pose[0], pose[1], 0.4 * pose[2]])
        wanted = [dict(X=foot[0], Y=foot[1], psi=foot[2])[name] for name in names]
        error = np.asarray(problem.stage(x, 0.1, 15.0, wanted)[0]).ravel()
        expected = measures.seen_from_the_path(*x, foot)
        found = dict(zip(problem.tracked, error, strict=True))
        assert [found[n] for n in ("e_x", "e_y", "e_psi")] == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_the_course_error_is_the_angle_from_the_path_to_the_velocity():
    """By the velocity's components along and across the path, of a car on the ground that slides to its side."""
    car = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r",)))
    problem = OCP(car, horizon=3, controls=("delta",), Q=Weights(e_y=1.0, e_course=1.0))
    for v_y, psi, wanted_psi in uniform(2, 50, (-4, 4), (-2, 2), (-1, 1)):
        values = {"v_y": v_y, "psi": psi, "X": 3.0, "Y": 4.0}
        x = np.array([values.get(n, 0.1) for n in car.states])
        wanted = [dict(X=0.0, Y=0.0, psi=wanted_psi)[name] for name in problem.references]
        error = dict(zip(problem.tracked, np.asarray(problem.stage(x, 0.1, 15.0, wanted)[0]).ravel(), strict=True))
        velocity = (15.0 + 1j * v_y) * np.exp(1j * (psi - wanted_psi))
        assert np.exp(1j * error["e_course"]) == pytest.approx(velocity / abs(velocity), abs=1e-12)
    with pytest.raises(ParameterError, match="e_course"):
        OCP(Kinematic(params=SOUSA_TABLE_7_2, dt=0.05), horizon=3, controls=("delta",), Q=Weights(e_course=1.0))


@pytest.mark.parametrize(("said", "unit"), [("Deg/Sec", "deg/s"), ("RAD/SEC", "rad/s"), ("mps", "m/s")])
def test_units_as_loggers_spell_them(said, unit):
    assert to_si(3.0, said) == to_si(3.0, unit)
