"""`Compensated`: followers that see the car where their steering acts, without steady error."""

import math

import numpy as np
import pytest
from scipy import linalg

from slipangle.control.default_drive import default_estimator
from slipangle.control.driver import Driver
from slipangle.control.followers.compensated import Compensated
from slipangle.control.followers.feedforward import FeedforwardFeedback
from slipangle.control.followers.followers import PurePursuit, Stanley
from slipangle.control.followers.preview_lqr import PreviewLQR
from slipangle.errors import ParameterError
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Values
from slipangle.paths.lane_change import double_lane_change
from slipangle.paths.path import Path
from slipangle.simulate.drive import drive
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from tests.control.test_driver import LATE, NOISE, PUSHED, RAW, STEERING, car

CAR = {"params": SOUSA_TABLE_7_2, "dt": 0.02, "horizon": 50}
LAWS = {
    "pure pursuit": PurePursuit(**CAR),
    "Stanley": Stanley(**CAR),
    "LQR": PreviewLQR(**CAR),
    "feed-forward": FeedforwardFeedback(**CAR),
}
EACH = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())


def bend(radius=250.0, v_x=25.0):
    angle = np.linspace(0.0, 400.0, 201) / radius
    return Path.from_points(radius * np.sin(angle), radius * (1 - np.cos(angle))).with_speed(v_x)


def driven(law, path, model, **more):
    told = Compensated(follower=law, car=LATE)
    plant = Plant(model, **STEERING)
    x0 = plant.straight(path.speed(0.0))
    push = more.pop("push", 0.0)
    if "d_v_y" in model.states:
        x0[model.states.index("d_v_y")] = push
    estimator = default_estimator(told.model, NOISE, {})
    return drive(plant, Driver(LATE, path, controller=told, estimator=estimator), channels=RAW, x0=x0, **more)


@EACH
@pytest.mark.parametrize("what", [pytest.param(n, marks=[pytest.mark.slow] * (n != "wind")) for n in PUSHED])
def test_no_steady_error_on_a_bend_whatever_pushes_the_car(law, what):
    """On a bend of 250 m at 25 m/s, after 9 s: at most 1 cm."""
    model = car(**PUSHED[what])
    held = Values(bank=PUSHED[what].get("bank", 0.0)) if "bank" in model.inputs else None
    run = driven(law, bend(), model, duration=12.0, held=held, push=PUSHED[what].get("d_v_y", 0.0))
    assert np.abs(run.e_y[run.t > 9.0]).max() < 0.01


@pytest.mark.slow
@EACH
def test_a_lane_change_is_better_than_without(law):
    """ISO 3888-1 at 20 m/s, 20 ms of delay and 50 ms of lag: the plain law, told the same estimate, is worse.

    Feed-forward already steers earlier by what the car takes to answer, so that it gains nothing in a lane change.
    """
    path, plant = double_lane_change(20.0), Plant(car(), **STEERING)
    estimator = default_estimator(Compensated(follower=law, car=LATE).model, NOISE, {})
    plain = closed_loop(plant, law, path, estimator=estimator)
    told = closed_loop(plant, Compensated(follower=law, car=LATE), path, estimator=estimator)
    assert told.rmse("y") < (1.1 if isinstance(law, FeedforwardFeedback) else 0.75) * plain.rmse("y")


@EACH
def test_in_steady_driving_the_answer_is_the_models_steering(law):
    """On the path, at the slip of the bend and with the steering of the bend in its lag and delay, pushed or not."""
    told, path, v_x = Compensated(follower=law, car=LATE), bend(v_x=24.0), 24.0  # m/s, in the table of `SteadyStates`
    for d in (0.0, 1.0):
        r = v_x / 250.0
        A, B = base_matrices(v_x)
        F = linalg.expm(0.02 * A)
        G = np.linalg.solve(A, (F - np.eye(2)) @ B)
        # [v_y, r] = F [v_y, r] + G delta + 0.02 [d, 0], by hand
        rest = F - np.eye(2)
        v_y, delta = np.linalg.solve(np.column_stack([rest[:, 0], G]), -rest[:, 1] * r - 0.02 * np.array([d, 0.0]))
        back = told.lead * 0.02  # what the controller is told is where the car is before its steering acts
        angle = (30.0 - v_x * back) / 250.0
        values = {"v_y": v_y, "r": r, "delta_s": delta, "d_v_y": d, "d_r": 0.0}
        values |= {
            "X": 250.0 * math.sin(angle),
            "Y": 250.0 * (1 - math.cos(angle)),
            "psi": angle - math.atan2(v_y, v_x),
        }
        x = np.array([values.get(n, delta) for n in told.model.states])
        preview = path.ahead(30.0 - v_x * back, told.times)
        plan = told.plan(x, preview, applied=np.array([delta]))
        assert plan.command[0] == pytest.approx(delta, abs=2e-5)


def base_matrices(v):
    p = SOUSA_TABLE_7_2
    f, r, m, J = p.C_f, p.C_r, p.mass, p.inertia_z
    A = np.array(
        [
            [-(f + r) / (m * v), -(f * p.l_f - r * p.l_r) / (m * v) - v],
            [-(f * p.l_f - r * p.l_r) / (J * v), -(f * p.l_f**2 + r * p.l_r**2) / (J * v)],
        ]
    )
    return A, np.array([f / m, f * p.l_f / J])


def test_the_lead_is_delay_and_lag():
    stanley = LAWS["Stanley"]
    assert Compensated(follower=stanley, car=LATE).lead == round((0.02 + 0.05) / 0.02)
    plain = Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("r",))
    assert Compensated(follower=stanley, car=plain).lead == 0
    told = Compensated(follower=stanley, car=Delayed(Steered(plain, steering_lag=0.15), delays={"delta": 0.05}))
    assert told.lead == 10
    assert told.times[-1] == pytest.approx(0.02 * 60)


def test_what_does_not_fit_is_said_and_a_broken_state_keeps_the_angle():
    plain = Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("r",))
    car_ = NonlinearBicycle(
        params=NonlinearBicycleParams(mass=1500, inertia_z=2000, wheelbase=2.7, l_f=1.3, C_f=9e4, C_r=1e5), dt=0.02
    )
    with pytest.raises(ParameterError, match=r"inputs \['v_x_dot'\]"):
        Compensated(follower=LAWS["Stanley"], car=car_)
    told = Compensated(follower=LAWS["Stanley"], car=plain)
    path = bend()
    x = np.full(told.model.n_states, np.nan)
    plan = told.plan(x, path.ahead(0.0, told.times), applied=np.array([0.03]))
    assert plan.status is Status.NOT_FINITE
    assert plan.command[0] == 0.03
