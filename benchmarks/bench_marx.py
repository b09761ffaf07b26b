"""Time of one plan of MARX-MPC, N = 10, three models, beside Ipopt, DAQP from Python, LMPC and NMPC.

Moments of a lane change at 15 m/s on the linear bicycle; every candidate in turn, one thread, warm. Inside C: monotonic
clock around the whole plan, condensing included. Through Python: process time of ``plan``. Ipopt solves the same cost
with the models side by side; DAQP solves the quadratic program that NumPy has condensed, once alone and once with the
condensing. LMPC and NMPC: eq. 7-1 with table 7.3 by our real-time solver, and by Ipopt with CVODES inside.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import daqp
import numpy as np

from slipangle.codegen.compiler import sentence
from slipangle.control.marx.interpreted import Interpreted
from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.marx.solver import Compiled
from slipangle.control.mpc import MPC
from slipangle.control.presets import SOUSA_TABLE_7_3, SOUSA_TABLE_7_5
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.wrappers.multi_arx import MultiARXModel, ParallelARX
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.engine import CompiledEngine
from slipangle.optimal.terms import Weights
from slipangle.paths.lane_change import double_lane_change
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_7 import (
    MORE_SPEEDS,
    SPEEDS,
    STEP,
    blended,
    general,
    linear_model,
    magic_model,
    planar_model,
)
from slipangle.reproduce._cvodes import ByCvodes

ROUNDS, MOMENTS = 30, 100
V_X = 13.0


def lateral_models() -> MultiARXModel:
    """Two lags of Y and of steering, as in the thesis: double integrators with a gain that grows with speed."""
    models = tuple(
        ARXModel(A=[-2.0, 1.0], B=[0.6 * b, 0.4 * b], dt=STEP, inputs=("delta",), outputs=("Y",))
        for b in (0.083, 0.17, 0.29)
    )
    return MultiARXModel(models=models, speeds=SPEEDS)


def moments(mpc: MultiARXMPC | MPC) -> list[tuple[np.ndarray, Reference, np.ndarray]]:
    """States, references and last inputs along a lane change with a little distance from it."""
    path = double_lane_change(V_X, blend=10.0)
    rng, found = np.random.default_rng(0), []
    for s in np.linspace(5.0, 150.0, MOMENTS):
        at = path.at(s)
        X, psi = float(at.X[0]), float(at.psi[0] + 0.01 * rng.standard_normal())
        Y = float(at.Y[0] + 0.05 * rng.standard_normal())
        seen = {"X": X, "Y": Y, "psi": psi, "v_x": V_X, "r": float(at.curvature[0]) * V_X, "v_y": 0.0}
        x = mpc.start(seen) if isinstance(mpc, MultiARXMPC) else np.array([seen[n] for n in mpc.model.states])
        look = path.ahead(float(s), mpc.horizon, STEP, v_x=V_X)
        found.append((x, mpc.reference(look), np.array([0.02 * rng.standard_normal()])))
    return found


def timed(mpc: Any, situations: list, count: int) -> tuple[list[float], list[float]]:
    """Process time through Python and, where there is one, time inside C."""
    process, inside, plan = [], [], None
    for x, reference, applied in situations[:count]:
        began = time.process_time()
        plan = mpc.plan(x, reference, plan, applied=applied)
        process.append(time.process_time() - began)
        if isinstance(mpc, MultiARXMPC) and isinstance(mpc.solver, Compiled):
            inside.append(mpc.solver.seconds)
        elif isinstance(mpc, MPC) and isinstance(mpc.engine, CompiledEngine):
            inside.append(mpc.engine.timing.total)
    return process, inside


def quadratic_programs(mpc: MultiARXMPC, situations: list) -> list[tuple]:
    """What DAQP is given for each moment."""
    caught: list[tuple] = []
    solver, solve = Interpreted(mpc.problem, mpc.numbers), daqp.solve

    def note(*args: Any) -> Any:
        caught.append(args)
        return solve(*args)

    daqp.solve = note
    try:
        for x, reference, applied in situations:
            solver.solve(x, reference.tracked, reference.exogenous, float(applied[0]), None, 0.0)
    finally:
        daqp.solve = solve
    return caught


def bench(progress: Progress) -> Reproduction:
    """Ours, then the peers."""
    ours = blended(lateral_models())
    heading, longer = blended(planar_model()), blended(planar_model(MORE_SPEEDS, "smooth"), horizon=20)
    both = dict.fromkeys(("e_y", "e_psi"), SOUSA_TABLE_7_3["Q"]["e_y"])
    limited = replace(heading, limits=SOUSA_TABLE_7_3["limits"], Q=Weights(both))
    fast = {
        "MARX, models of Y": ours,
        "MARX with heading": heading,
        "MARX with heading, e_psi weighted": limited,
        "MARX with heading, 6 models, N = 20": longer,
        "MARX with heading, 6 models, N = 20, 8 knots": replace(longer, knots=SOUSA_TABLE_7_5["knots"]),
        "LMPC": general(linear_model(), RealTime()),
        "NMPC": general(magic_model(), RealTime()),
    }
    situations = {name: moments(mpc) for name, mpc in fast.items()}
    process: dict[str, list[float]] = {name: [] for name in fast}
    inside: dict[str, list[float]] = {name: [] for name in fast}
    for mpc in fast.values():
        mpc.prepare()
    for i in range(ROUNDS):
        progress(0.6 * i / ROUNDS, f"round {i + 1}")
        for name, mpc in fast.items():
            a, b = timed(mpc, situations[name], MOMENTS)
            process[name] += a[2:]
            inside[name] += b[2:]
    records = []
    for name in fast:
        bounded = name in ("MARX, models of Y", "MARX with heading")
        for what, times, most in (("in C", inside[name], 5.0), ("through Python", process[name], 12.0)):
            if not times:
                records.append(Record(row=name, quantity=f"{what} [us]", thesis=None, here="-", note=sentence()))
                continue
            here = 1e6 * float(np.median(times))
            records.append(
                Record(
                    row=name,
                    quantity=f"{what} [us], median",
                    thesis=1e4 if bounded else None,
                    here=here,
                    bound=f"<= {most:g}" if bounded else "",
                    holds=here <= most if bounded else None,
                    note=f"p99 {1e6 * float(np.percentile(times, 99)):.1f}",
                )
            )
    base = float(np.median(process["MARX, models of Y"]))
    records += _peers(ours, situations["MARX, models of Y"], base, progress)
    return Reproduction(
        title="MARX-MPC, time of one plan",
        records=tuple(records),
        protocol=" ".join((__doc__ or "").split()) + f" {ROUNDS * (MOMENTS - 2)} plans of each of ours.",
    )


def _peers(ours: MultiARXMPC, situations: list, base: float, progress: Progress) -> list[Record]:
    """Ipopt and DAQP on the same problem, LMPC and NMPC in the thesis' way."""
    found = []
    progress(0.65, "DAQP from Python")
    programs = quadratic_programs(ours, situations)
    solver = Interpreted(ours.problem, ours.numbers)
    alone = _median(lambda k: daqp.solve(*programs[k]), len(programs))
    whole = _median(
        lambda k: solver.solve(
            situations[k][0],
            situations[k][1].tracked,
            situations[k][1].exogenous,
            float(situations[k][2][0]),
            None,
            0.0,
        ),
        len(situations),
    )
    rows = [("DAQP from Python, quadratic program alone", alone), ("DAQP from Python, NumPy condenses", whole)]
    progress(0.75, "Ipopt")
    base_model = ours.blended
    side = ParallelARX(models=base_model.models, speeds=base_model.speeds)
    settings: dict[str, Any] = SOUSA_TABLE_7_3 | {"Q": Weights(Y=SOUSA_TABLE_7_3["Q"]["e_y"])}
    ipopt = MPC(side, solver=Ipopt(tolerance=1e-8), controls=("delta",), **settings)
    many = []
    for x, reference, applied in situations[:20]:
        lags, past = x[: base_model.na], x[base_model.na :]
        wide = np.concatenate([*[lags] * len(base_model.models), past])
        many.append((wide, Reference(tracked=reference.tracked[:, 1:2], exogenous=reference.exogenous), applied))
    rows.append(("MARX by Ipopt", float(np.median(timed(ipopt, many, 20)[0][2:]))))
    for name, model in (("LMPC", linear_model()), ("NMPC", magic_model())):
        progress(0.85, f"{name} by Ipopt")
        slow = general(ByCvodes(model), Ipopt(tolerance=1e-6))
        rows.append((f"{name} by Ipopt with CVODES", float(np.median(timed(slow, moments(slow), 5)[0][2:]))))
    for name, seconds in rows:
        found.append(
            Record(
                row=name,
                quantity="time of a plan over ours through Python [-]",
                thesis=None,
                here=seconds / base,
                note=f"{1e6 * seconds:.4g} us, process time, median",
            )
        )
    return found


def _median(call: Callable[[int], Any], count: int) -> float:
    spent = []
    for _ in range(10):
        for k in range(count):
            began = time.process_time()
            call(k)
            spent.append(time.process_time() - began)
    return float(np.median(spent))
