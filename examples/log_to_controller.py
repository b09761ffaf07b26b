"""From a log to a controller in forty lines: what `slipangle demo` does, in Python.

python examples/log_to_controller.py
"""

import slipangle as sa
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.workflow.demo import prepare_demo

folder = prepare_demo("slipangle-out/example").parent  # a test drive of a built-in car, as a CSV file

# log -> data: channels by the file's headings, SI units inside
log = sa.read(
    folder / "drive_log.csv",
    {"delta": "steer", "v_x": "speed", "v_y": "lateral speed", "r": "yaw rate"},
    inputs=["delta", "v_x"],
    outputs=["v_y", "r"],
)
print(*sa.inspect(log).sentences[:3], sep="\n")
train, test = log.resample(0.05, cutoff=8.0).hold_mean().split(0.7)

# data -> model: mass and geometry are known, stiffness and inertia are not
known = sa.BicycleParams(mass=2500, wheelbase=2.7, l_f=1.35, inertia_z=4000, C_f=6e4, C_r=6e4)
start = sa.Bicycle(params=known, dt=train.dt, outputs=("v_y", "r"))
bicycle = sa.GreyBox(start=start, free=("C_f", "C_r", "inertia_z")).fit(train)
verdict = sa.validate(bicycle, test, train=train)  # beside simple models of the same data, and the noise
print(*(stands.sentence for stands in verdict.standing.values()), sep="\n")

# model -> controller -> closed loop with the car itself, wheel spin and saturating tires included
mpc = sa.MPC(
    sa.OnGround(bicycle),
    horizon=20,
    controls=("delta",),
    Q=sa.Weights(X=0.1, Y=1.0, psi=1.0),
    S=sa.Weights(delta=50.0),
    limits=sa.Limits(delta=(-sa.deg(20), sa.deg(20))),
    rates=sa.Limits(delta=(-sa.deg(60), sa.deg(60))),
)
car = sa.SingleTrack(params=SOUSA_TABLE_6_1, dt=0.001, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2)
driver = sa.SpeedDriver.for_car(mass=2500, radius=0.42, limits=(-8000, 4000))
run = sa.closed_loop(sa.Plant(car), mpc, sa.double_lane_change(20.0), driver=driver)
print(f"lateral RMSE {100 * run.rmse('y'):.1f} cm, inside the lanes: {run.inside}, {run.end.value}")
