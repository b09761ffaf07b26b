"""Steering, throttle and brake from one predictive controller: from a standstill to 30 m/s, out of the lane and back.

python examples/steering_and_pedals.py
"""

import numpy as np

import slipangle as sa
from slipangle import ops
from slipangle.control.speed.pedals import drive_force
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE, SOUSA_CAR_7

CAR, G, MU, C = SOUSA_CAR_7, 9.81, 0.9, 2e5  # C: cornering stiffness of each axle [N/rad]
PULL, POWER = 0.8 * drive_force(CAR, 3.0), 30.0 * drive_force(CAR, 30.0)  # N, W: what full throttle gives
STOP = CAR.brakes.torque / CAR.radius  # N: the whole brake pedal


def forces(x, u):
    """Along the car, and across it at the front and rear axle, from tires that saturate."""
    v = ops.maximum(x[0], 2.0)  # m/s: slip angles at a standstill
    along = u[1] * ops.minimum(PULL, POWER / v) - u[2] * STOP * ops.tanh(2.0 * x[0])
    most_f, most_r = (MU * CAR.mass * G * arm / CAR.wheelbase for arm in (CAR.l_r, CAR.l_f))
    front = most_f * ops.tanh(C * (u[0] * x[0] / v - (x[1] + CAR.l_f * x[2]) / v) / most_f)
    return along, front, most_r * ops.tanh(-C * (x[1] - CAR.l_r * x[2]) / v / most_r)


def motion(x, u, _):
    """Rates of v_x, v_y and r; u is the steering angle, throttle and brake."""
    along, front, rear = forces(x, u)
    turning = (CAR.l_f * front - CAR.l_r * rear) / CAR.inertia_z
    return [along / CAR.mass + x[1] * x[2], (front + rear) / CAR.mass - x[0] * x[2], turning]


def grip(x, u, _):
    """How much of the friction circle drive, brakes and cornering take together."""
    along, front, rear = forces(x, u)
    return (along**2 + (front + rear) ** 2) / (MU * CAR.mass * G) ** 2


weights = {"Q": sa.Weights(e_y=2.0, e_psi=10.0, v_x=0.5, both=1000.0), "R": sa.Weights(throttle=0.05, brake=0.05)}
weights |= {"S": sa.Weights(delta=100.0, throttle=0.3, brake=0.3), "slack_linear": sa.Weights(grip=100.0)}
limits = sa.Limits(delta=0.4, throttle=(0.0, 1.0), brake=(0.0, 1.0), grip=(0.0, 0.8))
rates = sa.Limits(delta=0.7, throttle=4.0, brake=4.0)
names = {"states": ("v_x", "v_y", "r"), "inputs": ("delta", "throttle", "brake"), "outputs": ("v_x", "v_y", "r")}
model = sa.Ode(f=motion, params={}, dt=0.05, **names)
terms = {"grip": grip, "both": lambda x, u, _: u[1] * u[2]}  # pedals at once
mpc = sa.MPC(sa.OnGround(model), horizon=30, limits=limits, rates=rates, terms=terms, **weights)

x = np.arange(0.0, 601.0, 2.0)
y = np.where((x > 200) & (x < 400), 6.0 * (1 - np.cos(np.pi * (x - 200) / 100)), 0.0)
path = sa.Path.from_points(x, y, name="out and back").with_speed_limits(v_max=30.0, a_y=5.0, a_x=2.5, a_brake=4.0)
ends = np.sqrt(np.minimum(1.0 + 5.0 * path.s, 8.0 * np.maximum(path.length - 10.0 - path.s, 0.0)))  # m/s
path = path.with_speed(np.minimum(path.v_x, ends))

plant = sa.DualTrack(params=CAR, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001)
run = sa.closed_loop(sa.Plant(plant), mpc, path, x0=plant.straight(0.0), duration=48.0)
print(f"fastest {run.v_x.max():.1f} m/s, at the end {run.v_x[-1]:.2f}, {path.length - run.s[-1]:.1f} m before the end")
print(f"lateral RMSE {100 * run.rmse('y'):.1f} cm, inside the lanes: {run.inside}")
