"""The multi-body car of commonroad-vehicle-models (vehicle 2) as a plant for closed loops."""

import numpy as np

from slipangle.control.speed.driver import SpeedDriver
from slipangle.optimal.terms import Values
from tests.models.commonroad import plain, reference_parameters

NAMES = (
    *("X", "Y", "delta_w", "v_x", "psi", "r", "roll", "roll_rate", "pitch", "pitch_rate", "v_y"),
    *(f"other_{k}" for k in range(11, 29)),
)
DRIVER = SpeedDriver(
    kp=(2.0,),
    ki=(1.0,),
    limits=(-8.0, 3.0),
    feedforward=1.0,
    drive=Values(wanted_a_x=1.0),
    brake=Values(wanted_a_x=1.0),
)
WIDTH = 1.61  # m


class MultiBody:
    """Commands delta [rad], reached at the car's own largest steering rate, and wanted_a_x [m/s2]."""

    dt, inputs, outputs = 0.001, ("delta", "wanted_a_x"), NAMES

    def __init__(self):
        self.params = plain(reference_parameters())

    def reset(self, start):
        from vehiclemodels.init_mb import init_mb

        pose = [start["X"], start["Y"], 0.0, start["v_x"], start["psi"], 0.0, 0.0]
        self.x = np.array(init_mb(pose, self.params))
        return self.measured()

    def step(self, commands):
        from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

        h, p = self.dt, self.params
        u = [(commands["delta"] - self.x[2]) / (2 * h), commands["wanted_a_x"]]

        def f(x):
            return np.array(vehicle_dynamics_mb(x.tolist(), list(u), p))

        k1 = f(self.x)
        k2 = f(self.x + h / 2 * k1)
        k3 = f(self.x + h / 2 * k2)
        k4 = f(self.x + h * k3)
        self.x = self.x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return self.measured()

    def measured(self):
        return dict(zip(NAMES, self.x.tolist(), strict=True))
