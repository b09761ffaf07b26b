"""The car runs in another process, in any language; here in Python, with nothing of the toolbox, to show the messages.

python examples/plant_in_another_process.py
"""

import json
import socketserver
import subprocess
import sys
from math import cos, sin

import slipangle as sa

KNOWN = sa.BicycleParams(mass=1500, wheelbase=2.7, l_f=1.2, inertia_z=2500, C_f=9e4, C_r=1.1e5)


class Car(socketserver.StreamRequestHandler):
    """A bicycle that answers hello, reset and step, one line of JSON each."""

    def handle(self):
        for line in self.rfile:
            asked = json.loads(line)
            if "hello" in asked:
                self.say({"dt": 0.01, "inputs": ["delta"], "outputs": ["X", "Y", "psi", "v_x", "v_y", "r"]})
                continue
            if "reset" in asked:
                self.x = {"v_y": 0.0, "r": 0.0, **asked["reset"]}
            else:
                for _ in range(10):
                    self.drive(asked["step"]["delta"], 0.001)
            self.say({"measured": self.x})

    def drive(self, delta, h):
        x, p = self.x, KNOWN
        F_f = p.C_f * (delta - (x["v_y"] + p.l_f * x["r"]) / x["v_x"])
        F_r = p.C_r * -(x["v_y"] - (p.wheelbase - p.l_f) * x["r"]) / x["v_x"]
        x["v_y"] += h * ((F_f + F_r) / p.mass - x["v_x"] * x["r"])
        x["r"] += h * (p.l_f * F_f - (p.wheelbase - p.l_f) * F_r) / p.inertia_z
        x["psi"] += h * x["r"]
        x["X"] += h * (x["v_x"] * cos(x["psi"]) - x["v_y"] * sin(x["psi"]))
        x["Y"] += h * (x["v_x"] * sin(x["psi"]) + x["v_y"] * cos(x["psi"]))

    def say(self, answer):
        self.wfile.write(json.dumps(answer).encode() + b"\n")


if sys.argv[1:] == ["car"]:
    with socketserver.TCPServer(("127.0.0.1", 0), Car) as server:
        print("{}:{}".format(*server.server_address), flush=True)
        server.handle_request()
else:
    with subprocess.Popen([sys.executable, __file__, "car"], stdout=subprocess.PIPE, text=True) as other:
        with sa.PlantProcess(other.stdout.readline().strip()) as car:
            model = sa.OnGround(sa.Bicycle(params=KNOWN, dt=0.05, outputs=("v_y", "r")))
            weights = {"Q": sa.Weights(X=0.1, Y=1.0, psi=1.0), "S": sa.Weights(delta=50.0)}
            mpc = sa.MPC(model, horizon=20, controls=("delta",), limits=sa.Limits(delta=sa.deg(20)), **weights)
            run = sa.closed_loop(sa.Plant(car, lag=sa.Values(delta=0.03)), mpc, sa.double_lane_change(20.0))
    print(f"lateral RMSE {100 * run.rmse('y'):.1f} cm, inside the lanes: {run.inside}, {run.end.value}")
