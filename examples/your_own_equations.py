"""Equations of your own, from a log to a controller: a bicycle whose tires build up force over a relaxation length.

python examples/your_own_equations.py
"""

import warnings

import slipangle as sa
from slipangle import ops
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.units import SI
from slipangle.workflow.demo import prepare_demo

MASS, L_F, L_R = 2500.0, 1.35, 1.35


def relaxed_bicycle(x, u, p):
    """Rates of v_y, r and of the axles' slip angles; u is the steering angle and the speed."""
    v_y, r, alpha_f, alpha_r = x[0], x[1], x[2], x[3]
    v = ops.maximum(u[1], 1.0)
    F_f, F_r = p.C_f * alpha_f, p.C_r * alpha_r
    slip_f, slip_r = u[0] - (v_y + L_F * r) / v - alpha_f, -(v_y - L_R * r) / v - alpha_r
    moving, turning = (F_f + F_r) / MASS - v * r, (L_F * F_f - L_R * F_r) / p.inertia_z
    return [moving, turning, slip_f * v / p.relaxation, slip_r * v / p.relaxation]


columns = {"delta": "steer", "v_x": "speed", "v_y": "lateral speed", "r": "yaw rate"}
folder = prepare_demo("slipangle-out/example").parent  # a test drive of a built-in car, as a CSV file
log = sa.read(folder / "drive_log.csv", columns, inputs=["delta", "v_x"], outputs=["v_y", "r"])
train, test = log.resample(0.05, cutoff=8.0).hold_mean().split(0.7)

car = sa.Ode(
    f=relaxed_bicycle,
    states=("v_y", "r", "alpha_f", "alpha_r"),
    inputs=("delta", "v_x"),
    outputs=("v_y", "r"),
    params={
        "C_f": (6e4, SI("N/rad", "front cornering stiffness, per axle", 1.0, 1e7)),
        "C_r": (6e4, SI("N/rad", "rear cornering stiffness, per axle", 1.0, 1e7)),
        "inertia_z": (4000.0, SI("kg m2", "yaw inertia", 1.0, 1e6)),
        "relaxation": (0.3, SI("m", "relaxation length", 0.05, 3.0)),
    },
    dt=train.dt,
)
late = sa.Delayed(car, delays={"delta": 0.02}, longest=0.1)
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # what the log does not tell is printed below
    model = sa.GreyBox(start=late, free=("C_f", "C_r", "inertia_z", "relaxation", "delay_delta")).fit(train)
print(model.fit_info.confounding, *model.fit_info.warnings, sa.advise(model, train)[0].sentence, sep="\n")
print({name: f"fit {score.fit:.1f} %" for name, score in sa.validate(model, test).free_run_scores.items()})

limits, rates = (sa.Limits(delta=(-sa.deg(a), sa.deg(a))) for a in (20, 60))
weights = {"Q": sa.Weights(X=0.1, Y=1.0, psi=1.0), "S": sa.Weights(delta=50.0)}
mpc = sa.MPC(sa.OnGround(model), horizon=20, controls=("delta",), limits=limits, rates=rates, **weights)
plant = sa.SingleTrack(params=SOUSA_TABLE_6_1, dt=0.001, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2)
driver = sa.SpeedDriver.for_car(mass=MASS, radius=0.42, limits=(-8000, 4000))
run = sa.closed_loop(sa.Plant(plant), mpc, sa.double_lane_change(20.0), driver=driver)
print(f"lateral RMSE {100 * run.rmse('y'):.1f} cm, inside the lanes: {run.inside}, {run.end.value}")
