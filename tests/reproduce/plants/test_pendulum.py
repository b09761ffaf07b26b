"""Cart and pendulum: the published gain of the balance system."""

import casadi as ca
import numpy as np

from slipangle.reproduce.plants.pendulum import Pendulum, PendulumParams

PUBLISHED_GAIN = np.array([-15.3, 1730.0, -50.0, 443.0])  # Astrom and Murray's balance system, on [p theta p' theta']


def linear(model):
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 1)
    rate = model.derivative(x, u)
    f = ca.Function("f", [x, u], [ca.jacobian(rate, x), ca.jacobian(rate, u)])
    return (np.asarray(m) for m in f(np.zeros(4), 0.0))


def test_the_published_gain_stabilises_the_model():
    A, B = linear(Pendulum(dt=0.1))
    assert np.linalg.eigvals(A).real.max() > 1.0
    closed = np.linalg.eigvals(A - B @ PUBLISHED_GAIN[None])
    assert closed.real.max() < -0.1
    for change in ({"mass": 40.0}, {"inertia": 400.0}, {"length": 2.0}):  # it belongs to these numbers
        A, B = linear(Pendulum(dt=0.1, params=PendulumParams(**change)))
        assert np.abs(np.linalg.eigvals(A - B @ PUBLISHED_GAIN[None]) - closed).max() > 0.05
