"""A car of another simulator: log -> model -> lane change -> page. Needs commonroad-vehicle-models.

python examples/foreign_plant.py
"""

import numpy as np
from vehiclemodels.init_mb import init_mb
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

import slipangle as sa
from slipangle.data.signals.excitation import multisine, time
from slipangle.report import Figure, Page, Section, path_map
from slipangle.simulate.manoeuvres import Manoeuvre, record


class Car:
    """Any object with a rate, names, reset and step is a plant; SI units, angles to the left positive."""

    dt, inputs, outputs = 0.01, ("delta", "a_x"), ("X", "Y", "psi", "v_x", "v_y", "r")

    def reset(self, start):
        self.p = parameters_vehicle2()
        self.x = np.array(init_mb([start["X"], start["Y"], 0.0, start["v_x"], start["psi"], 0.0, 0.0], self.p))
        return self.measured()

    def step(self, commands):
        h = self.dt / 5
        for _ in range(5):  # Runge-Kutta; the steering turns at most as fast as its own model lets it
            u = [(commands["delta"] - self.x[2]) / (2 * h), commands["a_x"]]
            k1 = self.rate(self.x, u)
            k2 = self.rate(self.x + h / 2 * k1, u)
            k3 = self.rate(self.x + h / 2 * k2, u)
            self.x = self.x + h / 6 * (k1 + 2 * k2 + 2 * k3 + self.rate(self.x + h * k3, u))
        return self.measured()

    def rate(self, x, u):
        return np.array(vehicle_dynamics_mb(x.tolist(), u, self.p))

    def measured(self):
        return dict(zip(self.outputs, self.x[[0, 1, 4, 3, 10, 5]].tolist(), strict=True))


plant = sa.Plant(Car(), noise=sa.Values(r=0.002, v_y=0.02, X=0.01, Y=0.01, psi=0.001))
pedals = sa.SpeedDriver(kp=(2.0,), ki=(1.0,), limits=(-8.0, 3.0), drive=sa.Values(a_x=1.0))
steering = 0.02 * multisine(2000, 0.01, f_min=0.1, f_max=2.0, seed=1)
drive = Manoeuvre(delta=steering, v_x=20.0 + 3.0 * np.sin(0.5 * time(2000, 0.01)), dt=0.01)
log = record(plant, drive, pedals, channels=("v_y", "r", "v_x")).select(inputs=("delta", "v_x"), outputs=("v_y", "r"))

known = sa.BicycleParams(mass=1093, wheelbase=2.58, l_f=1.16, inertia_z=1500, C_f=6e4, C_r=6e4)
start = sa.Bicycle(params=known, dt=0.01, outputs=("v_y", "r"))
car = sa.GreyBox(start=start, free=("C_f", "C_r", "inertia_z")).fit(log).resampled(0.05, outputs=("v_y", "r"))
weights = {"Q": sa.Weights(X=0.1, Y=1.0, psi=1.0), "S": sa.Weights(delta=50.0)}
mpc = sa.MPC(sa.OnGround(car), horizon=20, controls=("delta",), limits=sa.Limits(delta=sa.deg(20)), **weights)
run = sa.closed_loop(plant, mpc, sa.double_lane_change(20.0, width=1.61), driver=pedals, width=1.61)
print(f"lateral RMSE {100 * run.rmse('y'):.1f} cm, inside the lanes: {run.inside}, {run.end.value}")
figure = path_map(run["X"], run["Y"], run["psi"], reference=run.reference[:, :2])
page = Page(title="Lane change", sections=(Section(title="Path", blocks=(Figure(title="Path", figure=figure),)),))
print(page.write("slipangle-out/foreign-plant.html"))
