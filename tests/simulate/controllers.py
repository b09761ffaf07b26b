"""Predictive controllers for a dual-track car, their models identified on logs of that car."""

from functools import cache

import numpy as np

from slipangle.control.marx.adaptation import AdaptiveMultiARXMPC
from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.mpc import MPC
from slipangle.control.speed.pedals import pedal_driver
from slipangle.control.switched import SwitchedMPC
from slipangle.identify.linear.arx import ARX
from slipangle.models.tires.simple import LinearTire
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.wrappers.multi_arx import MultiARXModel
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.terms import Limits, Weights
from slipangle.reproduce._chapter_7 import Lateral
from slipangle.simulate.manoeuvres import Manoeuvre, record
from slipangle.simulate.plant import Plant

STEP = 0.05
LIMIT = float(np.deg2rad(20))


@cache
def arx(params, v_x):
    """ARX of lateral velocity and yaw rate from a multisine of up to 0.3 g."""
    t, rng = 0.01 * np.arange(2001), np.random.default_rng(1)
    delta = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) / (1 + f) for f in np.arange(0.1, 3.0, 0.1))
    peak = 3.0 * params.wheelbase * (1 + 3e-4 * v_x**2) / v_x**2
    delta = delta * peak / np.abs(delta).max() * np.minimum(t / 2, 1)
    plant = Plant(DualTrack(params=params, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001))
    manoeuvre = Manoeuvre(delta=delta, v_x=np.full(len(t), v_x))
    log = record(plant, manoeuvre, pedal_driver(params), channels=("v_y", "r")).resample(STEP)
    return ARX(na=1, nb=2).fit(log.select(inputs=("delta",), outputs=("v_y", "r")))


@cache
def controller(name, params, speeds, rate=1.0, horizon=20):
    """MARX, adaptive MARX, LMPC, NMPC or switched, all with the same weights and limits."""
    settings = {
        "horizon": horizon,
        "Q": Weights(e_y=100.0),
        "S": Weights(delta=1e4),
        "limits": Limits(delta=LIMIT),
        "rates": Limits(delta=rate),
    }
    if name in ("MARX", "adaptive"):
        model = MultiARXModel(models=tuple(arx(params, v) for v in speeds), speeds=speeds, shape="smooth")
        marx = MultiARXMPC(OnGround(model), **settings)
        return marx if name == "MARX" else AdaptiveMultiARXMPC(marx)
    if name == "switched":
        calm = controller("MARX", params, speeds, rate, horizon)
        return SwitchedMPC(calm, controller("NMPC", params, speeds, rate, horizon), enter=0.4, leave=0.3)
    tire = DualTrack(params=params, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001).tires[0]
    tires = (tire, tire)
    if name == "LMPC":
        loads = [0.5 * params.mass * GRAVITY * arm / params.wheelbase for arm in (params.l_r, params.l_f)]
        tires = tuple(LinearTire(C_alpha=float(tire.forces(0.0, 1e-4, F).F_y) / 1e-4) for F in loads)
    states = ("v_y", "r", "X", "Y", "psi")
    model = Lateral(params=params, tire_f=tires[0], tire_r=tires[1], dt=STEP, substeps=2, outputs=states)
    return MPC(model, solver=RealTime(iterations=0 if name == "NMPC" else 1), **settings)
