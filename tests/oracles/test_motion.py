"""Integrators, `OnGround`, `Delayed` and the pendulum against `tests.oracles.motion`."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest

from slipangle.models.model import Model
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.numerics.integrate import RADAU_A, discretise, radau_equations
from slipangle.ops import stack
from slipangle.reproduce.plants.emps import Emps, EmpsParams
from slipangle.reproduce.plants.pendulum import Pendulum
from tests.oracles import motion, vehicles
from tests.oracles.compare import agree, uniform

RADAU = motion.collocation(motion.radau_nodes())
METHODS = {"rk4": motion.CLASSICAL, "radau": RADAU, "euler": (np.zeros((1, 1)), np.ones(1))}


def test_radau_matrix_is_that_of_its_nodes():
    np.testing.assert_allclose(RADAU_A, RADAU[0], atol=1e-14)


@pytest.mark.parametrize("method", METHODS)
def test_one_step_multiplies_a_linear_system_by_its_stability_function(method):
    for z in (-80.0, -2.5, -0.3, 0.2):
        step = discretise(lambda x, u, z=z: z / 0.1 * x, 0.1, n_states=1, n_inputs=1, method=method)
        assert step(np.ones(1), np.zeros(1))[0] == pytest.approx(motion.stability(z, method), rel=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_one_step_of_a_nonlinear_system_is_that_of_the_tableau(method):
    once, twice = Pendulum(dt=0.02, method=method, substeps=1), Pendulum(dt=0.02, method=method, substeps=2)
    for x in uniform(0, 10, (-1, 1), (-3, 3), (-2, 2), (-2, 2)):
        whole, half = (
            lambda x, h=h: motion.runge_kutta(lambda y: motion.pendulum(y, 40.0), x, h, METHODS[method])
            for h in (0.02, 0.01)
        )
        np.testing.assert_allclose(once.step(x, np.array([40.0])), whole(x), rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(twice.step(x, np.array([40.0])), half(half(x)), rtol=1e-10, atol=1e-12)


def test_radau_equations_vanish_at_the_stages_of_the_tableau():
    h, x = 0.02, np.array([0.1, 0.4, -0.3, 0.2])
    k = np.zeros((3, 4))
    for _ in range(100):
        k = np.array([motion.pendulum(x + h * row @ k, 5.0) for row in RADAU[0]])
    z = (x + h * RADAU[0] @ k).T
    equations = radau_equations(Pendulum(dt=h).derivative, h, 4, 1)
    assert np.abs(np.asarray(equations(x, z, 5.0))).max() < 1e-12
    assert np.abs(np.asarray(equations(x, z + 1e-3, 5.0))).max() > 1e-4


@pytest.mark.parametrize(("method", "order"), [("euler", 1), ("rk4", 4), ("radau", 5)])
def test_order_on_a_nonlinear_system(method, order):
    x = np.array([0.1, 2.4, -0.3, 0.8])
    steps = (256, 512) if method == "euler" else (8, 16)
    exact = Pendulum(dt=1.0, method="radau", substeps=200).step(x, np.zeros(1))
    error = [np.abs(Pendulum(dt=1.0, method=method, substeps=n).step(x, np.zeros(1)) - exact).max() for n in steps]
    assert np.log2(error[0] / error[1]) == pytest.approx(order, abs=0.5)


def test_pendulum_solves_its_mass_matrix():
    def oracle(p, angle, v, omega, F):
        return np.array([motion.pendulum(x, f) for *x, f in zip(p, angle, v, omega, F, strict=True)]).T

    model = Pendulum(dt=0.02)
    agree(
        lambda *z: model.derivative(z[:4], z[4:]),
        oracle,
        uniform(1, 100, (-1, 1), (-4, 4), (-3, 3), (-3, 3), (-90, 90)),
    )


def test_carriage_with_friction():
    numbers = dict(mass=95.0, viscous=210.0, coulomb=20.0, offset=-3.0, v_slip=2e-3)
    model = Emps(params=EmpsParams(**numbers), dt=1e-3)

    def oracle(q, v, force):
        return [v, (force - 210.0 * v - 20.0 * np.tanh(v / 2e-3) + 3.0) / 95.0]

    agree(lambda *z: model.derivative(z[:2], z[2:]), oracle, uniform(2, 100, (-1, 1), (-0.3, 0.3), (-200, 200)))


# ---- over ground ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Moves(Model):
    """Whatever the velocities and the yaw rate are next is said by the inputs."""

    dt: float = 0.08
    inputs = ("next_v_x", "next_v_y", "next_r")
    outputs = ("r",)
    states = ("v_x", "v_y", "r")

    def initial_state(self, data):
        return np.zeros(3)

    def step(self, x, u):
        return stack([u[0], u[1], u[2]])

    def output(self, x, u):
        return stack([x[2]])


MOVES = uniform(3, 300, (2, 40), (-3, 3), (-0.9, 0.9), (-50, 50), (-50, 50), (-6, 6), (2, 40), (-3, 3), (-0.9, 0.9))


def test_pose_by_simpsons_rule():
    model = OnGround(Moves())

    def oracle(*z):
        found = [motion.over_ground(row[3:6], 0.08, row[:3], row[6:]) for row in np.array(z).T]
        return [*z[6:], *np.array(found).T]

    agree(lambda *z: model.step(stack(z[:6]), stack(z[6:])), oracle, MOVES)


def test_pose_is_exact_to_the_fifth_order():
    """The rule's error in one step falls by 2^5 with half the time, for the same rates of change."""

    def miss(h):
        model, worst = OnGround(Moves(dt=h)), 0.0
        for row in MOVES[:40]:
            after = row[:3] + (row[6:] - row[:3]) * h
            found = model.step(row[:6], after)[3:]
            worst = max(worst, np.abs(found - motion.over_ground_exactly(row[3:6], h, row[:3], after)).max())
        return worst

    assert np.log2(miss(0.4) / miss(0.2)) == pytest.approx(5.0, abs=0.3)
    assert miss(0.05) < 1e-7


@pytest.mark.parametrize(("v_y", "lateral"), [("zero", lambda x: 0.0), (1.3, lambda x: 1.3 * x[1])])
def test_what_moves_sideways_where_the_model_does_not_know(v_y, lateral):
    """``v_y=l`` is a point l behind the centre of gravity that does not slip: v_y - l r = 0."""
    car = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, substeps=1)
    model = OnGround(car, v_y=v_y)
    numbers = {n: getattr(SOUSA_TABLE_7_2, n) for n in ("mass", "inertia_z", "wheelbase", "l_f", "C_f", "C_r")}
    for row in uniform(4, 20, (-1, 1), (-0.5, 0.5), (-9, 9), (-9, 9), (-3, 3), (-0.1, 0.1), (8, 30)):
        x, (delta, v_x) = row[:5], row[5:]
        later = motion.runge_kutta(
            lambda y, d=delta, v=v_x: np.array(vehicles.bicycle(numbers, *y, d, v)), x[:2], 0.05, motion.CLASSICAL
        )
        before, after = [v_x, lateral(x), x[1]], [v_x, lateral(later), later[1]]
        wanted = [*later, *motion.over_ground(x[2:], 0.05, before, after)]
        np.testing.assert_allclose(model.step(x, row[5:]), wanted, rtol=1e-10, atol=1e-12)


# ---- late inputs ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.05, 0.0623, 0.1, 0.137, 0.15])
def test_an_input_acts_as_late_as_it_is_said_to(delay):
    car = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05)
    model = Delayed(car, delays={"delta": delay}, longest=0.15)
    n = model.n_past
    for row in uniform(5, 20, (-1, 1), (-0.5, 0.5), *((-0.1, 0.1),) * (n + 1), (8, 30)):
        x, past, delta, v_x = row[:2], row[2 : 2 + n], row[2 + n], row[-1]
        acting = motion.late([delta, *past], delay / 0.05)
        found = model.step(row[: 2 + n], np.array([delta, v_x]))
        wanted = [*car.step(x, np.array([acting, v_x])), delta, *past[:-1]]
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-14)
        symbolic = np.asarray(model.functions[0](row[: 2 + n], ca.DM([delta, v_x]))).ravel()
        np.testing.assert_allclose(symbolic, wanted, rtol=1e-12, atol=1e-14)
