"""Example 5: inverted pendulum swung up by predictive control, 20 steps of 0.1 s, |F| <= 800 N.

The thesis does not print the parameters; they are those of the balance system of Astrom and Murray, whose equations
it uses (see `slipangle.reproduce.plants.pendulum`). It writes the state as [theta p ...] and Q with 100 in the second
place and "a more significant penalty for theta", and starts from [0 pi 0 0]: only the order [p theta ...] fits both,
and is used here. S = 0 and R = 0 as printed. With these weights the pendulum is upright after about 15 s; a heavier
terminal weight, 100 Q, takes 3 s and is shown as a last row. Plant: CVODES, 0.1 s per step, 20 s, the state
measured without noise. Driven by real-time iterations, by converged plans, and the thesis' own way, Ipopt on
multiple shooting, of the same problem in the same run. Nothing is random.
"""

import time
from typing import Any

import casadi as ca
import numpy as np

from slipangle import MPC, Channel, Ipopt, Limits, RealTime, Reference, Weights
from slipangle.models.ode import OdeModel
from slipangle.optimal.solution import Plan
from slipangle.report.drives import Signal, signals
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce.plants.pendulum import Pendulum

STEPS, STEP, FORCE = 200, 0.1, 800.0


def controller(solver: Any, *, end: float = 1.0) -> MPC:
    """Eq. 5-9; the last state counts ``end`` times as much as the others."""
    return MPC(
        Pendulum(dt=STEP),
        horizon=20,
        Q=Weights(p=1.0, theta=100.0, v=1.0, omega=1.0),
        terminal=Weights(p=end, theta=100.0 * end, v=end, omega=end),
        limits=Limits(F=FORCE),
        solver=solver,
    )


def swing_up(mpc: MPC) -> tuple[np.ndarray, np.ndarray, float, list[Plan]]:
    """States, shape (STEPS + 1, 4), forces, median process time of a plan [s], plans."""
    mpc.prepare()
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u")
    ode = {"x": x, "p": u, "ode": mpc.model.derivative(x, [u])} if isinstance(mpc.model, OdeModel) else {}
    plant = ca.integrator("plant", "cvodes", ode, 0.0, STEP, {"reltol": 1e-10, "abstol": 1e-10})
    reference = Reference(tracked=np.zeros((21, 4)), exogenous=np.empty((20, 0)))
    states, forces, seconds, plans = [np.array([0.0, np.pi, 0.0, 0.0])], [], [], []
    plan = None
    for _ in range(STEPS):
        began = time.process_time()
        plan = mpc.plan(states[-1], reference, plan)
        seconds.append(time.process_time() - began)
        plans.append(plan)
        forces.append(plan.command[0])
        states.append(np.asarray(plant(x0=states[-1], p=plan.command)["xf"]).ravel())
    return np.array(states), np.array(forces), float(np.median(seconds[1:])), plans


def closed_loop_cost(states: np.ndarray) -> float:
    """Sum of the weighted squared states."""
    return float((states**2 @ [1.0, 100.0, 1.0, 1.0]).sum())


def figure(states: np.ndarray, forces: np.ndarray) -> Any:
    """Position, velocity, angle, angular rate and force over time, as figure 5.3."""
    panels = [("p", "m", 0), ("v", "m/s", 2), ("theta", "rad", 1), ("omega", "rad/s", 3)]
    rows = [Signal(channel=Channel(name, unit), values=states[:-1, k]) for name, unit, k in panels]
    rows.append(Signal(channel=Channel("F", "N"), values=forces, lower=-FORCE, upper=FORCE, held=True))
    return signals(STEP * np.arange(STEPS), rows)


def reproduce(progress: Progress) -> Reproduction:
    """Swing up four times."""
    records: list[Record] = []
    times: dict[str, float] = {}
    costs: dict[str, float] = {}
    runs = {
        "real-time iteration": controller(RealTime()),
        "converged": controller(RealTime(iterations=0)),
        "Ipopt": controller(Ipopt(tolerance=1e-8)),
        "real-time iteration, terminal weight 100 Q": controller(RealTime(), end=100.0),
    }
    figures = []
    for k, (name, mpc) in enumerate(runs.items()):
        progress(k / len(runs), name)
        states, forces, times[name], plans = swing_up(mpc)
        if name.startswith("real-time"):
            figures.append(figure(states, forces))
        costs[name] = closed_loop_cost(states)
        late = (np.flatnonzero(np.abs(states[:, 1]) >= np.deg2rad(2))[-1] + 1) * STEP
        position, angle = np.abs(states[-1, :2])
        largest, fallbacks = float(np.abs(forces).max()), sum(p.age > 0 for p in plans)
        printed, note = "stabilised at zero (figure)", f"{fallbacks} fallbacks in {STEPS} steps"
        said = f"within 2 degrees for good after {late:.1f} s; position at the end {position:.2g} m"
        records += [
            Record.judged(name, "angle at the end [deg]", printed, float(np.rad2deg(angle)), at_most=0.5, note=said),
            Record.judged(name, "largest force [N]", FORCE, largest, at_most=FORCE, note=note),
        ]
    fast, slow = times["real-time iteration"], times["Ipopt"]
    cost, note = costs["real-time iteration"] / costs["converged"], f"Ipopt: {costs['Ipopt'] / costs['converged']:.4g}"
    said = f"{1e6 * fast:.0f} us and {1e6 * slow:.0f} us, process time, median"
    pairs, ratio = [f"real-time iteration and {other}" for other in ("converged", "Ipopt")], "time of a plan, ratio [-]"
    records += [
        Record.judged(pairs[0], "closed-loop cost, ratio [-]", None, cost, at_most=1.1, note=note),
        Record.judged(pairs[1], ratio, None, slow / fast, at_least=50, note=said),
    ]
    more = "Figures: real-time iterations, with the last state's weight as the others' and with 100 Q."
    return Reproduction.told(__doc__, records, figures, more=more)
