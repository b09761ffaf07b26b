"""What a `Driver` takes where nothing is said: its model, its estimator and its controller, from the identified model.

Lengths, times and accelerations scale with the wheelbase L as those of bodies that move alike: a car of 2.7 m counts in
metres, radians and seconds as below, another one in lengths of L / 2.7 m and times of sqrt(L / 2.7 m) s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from slipangle.control.front_slip import front_slip, rear_slip
from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError
from slipangle.estimate.ekf import EKF
from slipangle.models.model import Model
from slipangle.models.ode import Parametrised
from slipangle.models.wrappers.disturbed import Disturbed
from slipangle.models.wrappers.lagging import Lagging
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.models.wrappers.wrapper import Wrapper
from slipangle.optimal.ocp import Reference
from slipangle.optimal.terms import Limits, Weights

USUAL = 2.7  # m, wheelbase of the car that the numbers are for
STAGES = (1, *[1] * 5, *[2] * 6, *[3] * 4, *[5] * 4)  # of the horizon, in steps of 0.02 s: one second
STEP = 0.02  # s, that these stages and the weights are for
E_Y, E_COURSE, CHANGE = 1.0, 5.0, 8.0  # weights per m2, per rad2, per rad2 of a step
E_PSI = 1.0  # per rad2, of models that know no course
BRISK = 24.0  # m/s up to which CHANGE holds; faster, a change counts by the lateral acceleration that it makes: v^2
ANGLE, RATE = 0.5, 1.05  # rad and rad/s at the road wheels
WANDER = {"v_y": 0.3, "r": 0.05, "d_v_y": 0.5, "d_r": 0.3}  # how far a state wanders in a root of a second
SLOWER = {"d_v_y": 0.03, "d_r": 0.03}  # factors of these where a late answer is told from a push (`Lagging`)
START = {"v_y": 0.3, "r": 0.1, "d_v_y": 0.5, "d_r": 0.3}  # standard deviation of states at the start
POSE_WANDER = {"X": 0.01, "Y": 0.01, "psi": 0.001}
LAG_STD, LAG_LEAST, LAG_FADING = 0.03, 0.002, 20.0  # s, of the steering's lag beyond that of the model, see `Lagging`
SURE = 1.5  # surprise up to which a model is trusted wholly [-]
UNKNOWN, DOUBTED, TRUSTED = 4.5, 50.0, 1.0  # surprise at the start and at most [-]; time over which it is averaged [s]
MOST = 10.0  # times that, from which weights do not change any more
GATE, PATIENCE = 8.0, 5  # of outliers
WITHIN = 0.97  # of the slip angle at which an axle's force peaks; no force is lost there, and speeds may read wrong
PAST_PEAK = 50.0  # weight per rad by which an axle slips more than that
# Of the size, by which these scale; of what wanders in a root of a second.
_POWER = {"v_y": 0.5, "r": -0.5, "d_r": -1.0, "X": 1.0, "Y": 1.0}


def _parameter(model: Model, name: str, otherwise: float) -> float:
    """A parameter of the identified model, where it has one of that name."""
    while isinstance(model, Wrapper) and not isinstance(model, Parametrised):
        model = model.model
    if isinstance(model, Parametrised) and name in model.parameter_names:
        return model.value(name)
    return otherwise


def size_of(model: Model) -> float:
    """Wheelbase over that of the car that the defaults are for; 1 for a model without one. [-]"""
    return _parameter(model, "wheelbase", USUAL) / USUAL


def driven_model(model: Model, dt: float, *, lagging: bool = True) -> OnGround:
    """The identified model at a sample time [s] where it is an ODE, with what may push it, on the ground.

    By default its steering may answer later than the model says (`Lagging`).

    Raises ParameterError if it has no yaw rate among its states.
    """
    base = model.off_ground
    if isinstance(base, Parametrised):
        base = base.resampled(dt)
    if not any(name.startswith("d_") for name in base.states):
        known = {name.removeprefix("base ").removesuffix("[k]") for name in base.states}
        on = tuple(name for name in ("v_y", "r") if name in known)
        if "r" not in on:
            raise ParameterError(
                f"the model has the states {list(base.states)[:8]}; expected a yaw rate 'r' among them, so that what "
                "pushes the car can be told: give controller and estimator for another model"
            )
        if lagging and "delta" in base.inputs:
            times = math.sqrt(size_of(base))
            base = Lagging(base, least=LAG_LEAST * times, fading=LAG_FADING * times)
        base = Disturbed(base, on=on)
    posed: Any = model
    return replace(posed, model=base) if model.off_ground is not model else OnGround(base)


def default_estimator(model: OnGround, noise: Mapping[str, float], late: Mapping[str, float]) -> EKF:
    """A filter for the outputs of `driven_model`; noise that is not given is that of the fit's residuals.

    Where the lag of the steering is a state, what pushes the car is believed to change slowly, so that an answer that
    only comes late is not taken for a push.
    """
    size = size_of(model)
    scale = {name: size**power for name, power in _POWER.items()}
    states = {name.removeprefix("base ").removesuffix("[k]"): name for name in model.states}
    start = {n: v * scale.get(n, 1.0) for n, v in START.items() if n in states}
    lags = [name for name in states if name.startswith("lag_")]
    slower = SLOWER if lags else {}
    wander = {
        n: v * scale.get(n, 1.0) * slower.get(n, 1.0) for n, v in {**WANDER, **POSE_WANDER}.items() if n in states
    }
    for name in lags:
        start[name] = LAG_STD * math.sqrt(size)
        wander[name] = LAG_STD * math.sqrt(2.0 / LAG_FADING) * size**0.25  # so that it stays as uncertain
    return EKF(
        start=model,
        noise_std=noise,
        process_std={states[n]: v for n, v in wander.items()},
        state_std={states[n]: v for n, v in start.items()},
        gate=GATE,
        patience=PATIENCE,
        late=late,
    )


def default_controller(model: OnGround, control: str = "delta", *, fastest: float = 0.0) -> MPC:
    """An MPC on `driven_model` that looks a second ahead: distance and course against quick steering.

    Of a model that knows no v_x or no v_y it is the heading instead of the course.

    ``fastest`` is the path's highest speed [m/s]. The faster a car is, the less its yaw is damped and the more lateral
    acceleration an angle makes: above 24 m/s (by Froude's rule for another size) quick steering costs more.

    Where an axle of the model has a slip angle at which its force is largest, the plan keeps to it. At the front more
    steering is less force past it, and an estimator that takes what is missing for a push would ask for ever more; at
    the rear the car spins.
    """
    size, gain = size_of(model), abs(_parameter(model, "steering_gain", 1.0))
    grain = model.dt / STEP
    steps: Any = [max(round(n / grain), 1) for n in STAGES]
    steps[0] = 1
    weight = CHANGE * max(1.0, fastest / (BRISK * math.sqrt(size))) ** 4 * gain**2 * size / grain**2
    coursed = {"v_x", "v_y"} <= {*model.states, *model.outputs, *model.inputs}
    slips = {"slip": front_slip(model, control), "slip_r": rear_slip(model, control)}
    terms = {name: slip for name, slip in slips.items() if slip is not None}
    known: Any = {"terms": terms, "slack_linear": Weights(dict.fromkeys(terms, PAST_PEAK))} if terms else {}
    peak = {name: WITHIN * slip.peak for name, slip in terms.items()}
    return MPC(
        model,
        horizon=len(steps),
        steps=None if set(steps) == {1} else tuple(steps),
        controls=(control,),
        Q=Weights(e_y=E_Y / size**2, **({"e_course": E_COURSE} if coursed else {"e_psi": E_PSI})),
        S=Weights({control: weight}),
        limits=Limits({control: ANGLE / gain, **peak}),
        rates=Limits({control: RATE / gain / math.sqrt(size)}),
        **known,
    )


def less_trusting(controller: MPC, reference: Reference, surprise: float) -> Reference:
    """The reference with the weights of a model that foretells what is measured as badly as this.

    ``surprise`` is the mean of the squared innovations over their variances, see `RecursiveVehicle.surprise`: one where
    the model is right. At n times 1.5, course or heading counts n times and quick steering n**3 times, n up to 10: the
    controller's bandwidth falls by about the root of n, and what the model leaves out, such as the relaxation of its
    tires, does not make the car swing. At the start n is 3, as the car is not known.
    """
    doubt = min(max(surprise / SURE, 1.0), MOST)
    if doubt == 1.0:
        return reference
    ocp = controller.ocp
    q, end, _, s = ocp.weights
    course = [doubt if n in ("e_course", "e_psi") else 1.0 for n in ocp.tracked]
    return replace(
        reference,
        Q=np.vstack([np.tile(q * course, (ocp.horizon, 1)), end * course]),
        S=np.tile(s * (doubt * doubt * doubt), (ocp.horizon, 1)),
    )


def require_told(controller: Any) -> None:
    """Raise ParameterError unless a driver can say all that a controller is told."""
    if len(controller.controls) != 1:
        raise ParameterError(
            f"the controller decides {list(controller.controls)}; expected the steering alone: pedals are those of the "
            "driver's speed law"
        )
    strange = [n for n in controller.exogenous if n not in ("v_x", "v_x_dot", *controller.model.inputs)]
    if strange:
        raise ParameterError(
            f"the controller is told {strange} over its horizon, which no driver knows; expected the speed and the "
            "model's inputs: write what stays the same into the terms"
        )
