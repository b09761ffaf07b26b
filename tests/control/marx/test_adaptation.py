"""Models that learn while driving: what they learn, and what the supervisor keeps away from them."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from slipangle.control.marx.adaptation import AdaptiveMultiARXMPC, Lesson, Supervisor
from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.errors import ParameterError
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.wrappers.multi_arx import MultiARXModel
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights

SPEEDS = (10.0, 15.0, 20.0)


def model(gain=1.0):
    def one(k):
        A = np.array([[[-0.6 + 0.01 * k, 0.1], [0.05, -0.5 - 0.02 * k]]])
        B = gain * np.array([[[0.3 * k], [0.8]], [[0.2], [0.4 * k]]])
        return ARXModel(A=A, B=B, dt=0.05, inputs=("delta",), outputs=("v_y", "r"))

    return MultiARXModel(models=tuple(one(k) for k in (1.0, 1.5, 2.0)), speeds=SPEEDS)


BASE = MultiARXMPC(OnGround(model()), horizon=10, Q=Weights(e_y=100.0), S=Weights(delta=1e3), limits=Limits(delta=0.35))
FREE = Supervisor(lateral=1e3, gain=5.0)
ADAPTIVE = AdaptiveMultiARXMPC(BASE, supervisor=FREE)


def teach(controller, truth, speeds, *, steer=0.02, noise=0.0, n=400, seed=0, bias=0.0, spoil=None):
    """Drive the true model with random steering; every state is shown to the controller's `learn`."""
    rng = np.random.default_rng(seed)
    known, verdicts = controller._first, []
    x, u = np.zeros(truth.n_states), 0.0
    for k in range(n):
        v = float(speeds[k % len(speeds)])
        seen = x.copy()
        seen[:2] += noise * rng.standard_normal(2)
        if spoil is not None and k in spoil:
            seen[:2] += 5.0
        seen = np.concatenate([seen, np.zeros(3)])
        known = controller.learn(known, seen, v)
        verdicts.append(known.verdict)
        known = known._replace(x=seen, u=u)
        x = truth.step(x, np.array([u, v]))
        x[:2] += bias
        u = steer * rng.standard_normal()
    return known, Counter(verdicts)


def distance(known, truth):
    """Largest error of the response to steering, relative."""
    A, B, _ = truth.coefficients
    right = replace(BASE.numbers, A=A, B=B)
    wanted = ADAPTIVE._response(right)
    return np.abs(ADAPTIVE._response(known.numbers) - wanted).max() / np.abs(wanted).max()


def test_coefficients_of_all_models_are_learned():
    truth = model(gain=1.3)
    start = distance(ADAPTIVE._first, truth)
    known, verdicts = teach(replace(ADAPTIVE, prior=0.5), truth, np.linspace(10.0, 20.0, 41), steer=0.05, n=1500)
    assert start > 0.2
    assert distance(known, truth) < 0.01
    assert verdicts[Lesson.LEARNED] > 300


def test_a_model_whose_speed_is_not_driven_keeps_what_it_knows():
    known, _ = teach(ADAPTIVE, model(gain=1.3), [11.0, 12.5], n=600)
    A, B, _ = BASE.blended.coefficients
    assert known.numbers.A[2] == pytest.approx(A[2], abs=1e-12)
    assert known.numbers.B[2] == pytest.approx(B[2], abs=1e-12)
    assert np.abs(known.numbers.B[0] - B[0]).max() > 0.02


def test_the_constant_takes_a_bias():
    known, _ = teach(ADAPTIVE, model(), [12.0, 16.0], bias=np.array([0.01, -0.004]), n=600)
    assert known.numbers.c[0] == pytest.approx([0.01, -0.004], abs=1e-3)


def test_poor_excitation_teaches_nothing():
    for steer in (0.0, 1e-5):
        known, verdicts = teach(ADAPTIVE, model(gain=1.3), [15.0], steer=steer, noise=1e-3, n=500)
        assert verdicts[Lesson.LEARNED] == 0
        assert verdicts[Lesson.QUIET] > 400
        assert known.theta == pytest.approx(ADAPTIVE._first.theta)


def test_without_the_supervisor_noise_alone_would_spoil_the_model():
    careless = replace(ADAPTIVE, supervisor=replace(FREE, excitation=1e-12, least_change=0.0), forgetting=0.95)
    known, verdicts = teach(careless, model(), [15.0], steer=0.0, noise=2e-3, n=3000)
    assert verdicts[Lesson.LEARNED] > 1000
    assert np.abs(known.theta - careless._first.theta).max() > 0.05


def test_outliers_are_left_out():
    clean, _ = teach(ADAPTIVE, model(gain=1.2), [12.0, 17.0], noise=1e-4, n=500)
    spoiled, verdicts = teach(ADAPTIVE, model(gain=1.2), [12.0, 17.0], noise=1e-4, n=500, spoil=range(100, 500, 50))
    assert verdicts[Lesson.SURPRISING] >= 8
    assert distance(spoiled, model(gain=1.2)) < distance(clean, model(gain=1.2)) + 0.05


def test_saturation_and_foreign_speeds_teach_nothing():
    careful = AdaptiveMultiARXMPC(BASE, supervisor=Supervisor(lateral=1e-4))
    assert teach(careful, model(1.3), [15.0])[1][Lesson.LEARNED] <= 1
    assert teach(ADAPTIVE, model(1.3), [8.0, 25.0])[1][Lesson.OUTSIDE] == 399


def test_a_model_that_would_turn_the_other_way_is_not_trusted():
    strict = AdaptiveMultiARXMPC(BASE, prior=5.0, supervisor=Supervisor(lateral=1e3, surprise=1e6, gain=1.5))
    known, verdicts = teach(strict, model(gain=-1.0), [10.0, 15.0, 20.0], n=400)
    assert verdicts[Lesson.DOUBTFUL] > 50
    ratio = strict._response(known.numbers) / strict._start_response
    assert ratio.max() < 1.5
    assert ratio.min() > 1 / 1.5


def reference(v, Y=0.0):
    X = v * 0.05 * np.arange(11)
    return Reference(tracked=np.column_stack([X, np.full(11, Y), np.zeros(11)]), exogenous=np.full((10, 1), v))


def test_what_is_learned_travels_in_the_plans():
    truth = OnGround(model(gain=1.4))
    rng = np.random.default_rng(1)

    def run():
        x, plan, found = np.zeros(truth.n_states), None, []
        for _ in range(80):
            at = reference(14.0, 0.5 * rng.standard_normal())
            at.tracked[:, 0] += x[-3]
            plan = ADAPTIVE.plan(x, at, plan)
            assert plan.status is Status.SOLVED
            x = truth.step(x, np.array([plan.command[0], 14.0]))
            found.append(plan)
        return found

    plans = run()
    assert plans[0].verdict is Lesson.WAITING
    assert plans[-1].samples > 20
    learned = ADAPTIVE.learned(plans[-1])
    weights = np.array(truth.model.weights(14.0))  # one speed: only this blend can be known

    def gains(numbers_B):
        return np.tensordot(weights, numbers_B, 1)

    wanted, start = gains(truth.model.coefficients[1]), gains(BASE.numbers.B)
    assert np.abs(gains(plans[-1].memory.numbers.B) - wanted).max() < 0.05 * np.abs(start - wanted).max()
    x = 0.01 * rng.standard_normal(learned.n_states)
    row = np.concatenate([x[:2], [0.1], x[2:]])
    phi = np.append(np.concatenate([w * row for w in learned.weights(14.0)]), 1.0)
    assert learned.step(x, np.array([0.1, 14.0]))[:2] == pytest.approx(phi @ plans[-1].memory.theta)
    first = ADAPTIVE.plan(np.zeros(truth.n_states), reference(14.0, 0.3))  # the controller itself has not changed
    assert first.u == pytest.approx(BASE.plan(np.zeros(truth.n_states), reference(14.0, 0.3)).u)


def test_never_nan():
    plan = ADAPTIVE.plan(np.zeros(BASE.model.n_states), reference(14.0, 0.3))
    lost = ADAPTIVE.plan(np.full(BASE.model.n_states, np.nan), reference(14.0), plan)
    assert lost.verdict is Lesson.WAITING
    assert np.isfinite(lost.u).all()
    again = ADAPTIVE.plan(np.zeros(BASE.model.n_states), reference(14.0), lost)
    assert again.status is Status.SOLVED
    assert np.isfinite(again.memory.theta).all()


def test_bad_settings_say_what_to_do():
    with pytest.raises(ParameterError, match="forgetting"):
        replace(ADAPTIVE, forgetting=1.2)
    with pytest.raises(ParameterError, match="gain"):
        Supervisor(gain=0.9)
    with pytest.raises(ParameterError, match="positive"):
        Supervisor(surprise=0.0)
    with pytest.raises(ParameterError, match="nothing learned"):
        ADAPTIVE.learned(BASE.plan(np.zeros(BASE.model.n_states), reference(14.0)))
