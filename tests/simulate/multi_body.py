"""The multi-body car of commonroad-vehicle-models (vehicle 2) as a plant for closed loops."""

from types import SimpleNamespace

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


class MultiBodyPlant:
    """Inputs delta [rad], reached at the car's own largest steering rate, and wanted_a_x [m/s2]."""

    dt = 0.001
    model = SimpleNamespace(inputs=("delta", "wanted_a_x"), outputs=(), states=NAMES, n_states=len(NAMES), n_inputs=2)
    channels = (*NAMES, "delta", "wanted_a_x")

    def __init__(self):
        self.params = plain(reference_parameters())

    def straight(self, v_x, *, X=0.0, Y=0.0, psi=0.0):
        from vehiclemodels.init_mb import init_mb

        return np.array(init_mb([X, Y, 0.0, v_x, psi, 0.0, 0.0], self.params))

    def start(self, x, inputs):
        return _Drive(self, np.array(x, dtype=float), np.array(inputs, dtype=float))


class _Drive:
    def __init__(self, plant, x, inputs):
        self.plant, self.x, self.inputs = plant, x, inputs

    def advance(self, command, steps):
        from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

        h, p = self.plant.dt, self.plant.params
        self.inputs = np.array(command, dtype=float)
        for _ in range(steps):
            turn = (command[0] - self.x[2]) / (2 * h)
            u = [turn, float(command[1])]

            def f(x, u=u):
                return np.array(vehicle_dynamics_mb(x.tolist(), list(u), p))

            k1 = f(self.x)
            k2 = f(self.x + h / 2 * k1)
            k3 = f(self.x + h / 2 * k2)
            k4 = f(self.x + h * k3)
            self.x = self.x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def true(self):
        values = dict(zip(self.plant.model.inputs, self.inputs.tolist(), strict=True))
        return values | dict(zip(NAMES, self.x.tolist(), strict=True))

    measure = true
