"""Free run of the bicycle on a measured-like log: ours beside SciPy's integrator and a plain NumPy loop.

Same equations, same fixed Runge-Kutta steps (SciPy: RK45 at its default tolerance), same inputs, one thread, in turn.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.integrate import solve_ivp

from slipangle.data.dataset import Dataset
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

ROUNDS, SAMPLES = 15, 11_000


def bench(progress: Progress) -> Reproduction:
    """Samples per second of each."""
    model = Bicycle(params=FERRARI_250LM, dt=0.05)
    t = np.arange(SAMPLES) * model.dt
    u = np.column_stack([0.03 * np.sin(0.9 * t), 25 + 8 * np.sin(0.11 * t)])
    data = Dataset.from_arrays({"delta": u[:, 0], "v_x": u[:, 1]}, {"r": np.zeros(SAMPLES)}, model.dt)
    model.simulate(data)

    def ours() -> np.ndarray:
        return model.simulate(data).y[:, 0]

    def numpy_loop() -> np.ndarray:
        x, r = np.zeros(2), np.zeros(SAMPLES // 20)
        for k in range(1, len(r)):
            x = model.step(x, u[k - 1])
            r[k] = x[1]
        return r

    def scipy_ivp() -> np.ndarray:
        n = SAMPLES // 20
        x, r = np.zeros(2), np.zeros(n)
        for k in range(1, n):
            held = u[k - 1]
            x = solve_ivp(lambda _, state, held=held: model.derivative(state, held), (0, model.dt), x).y[:, -1]
            r[k] = x[1]
        return r

    peers = {"slipangle": ours, "NumPy loop": numpy_loop, "SciPy solve_ivp": scipy_ivp}
    spent: dict[str, list[float]] = {name: [] for name in peers}
    results = {}
    for i in range(ROUNDS):  # in turn, so that a noisy moment hits all
        for name, run in peers.items():
            if i % 5 and name != "slipangle":
                continue
            progress((i + 0.5) / ROUNDS, f"{name}, round {i + 1}")
            began = time.process_time()
            results[name] = run()
            spent[name].append((time.process_time() - began) / len(results[name]))
    n = len(results["NumPy loop"])
    agree = float(np.abs(results["slipangle"][:n] - results["NumPy loop"]).max())
    rate = {name: 1 / float(np.median(s)) for name, s in spent.items()}
    late = {name: 1 / float(np.percentile(s, 99)) for name, s in spent.items()}
    records = [
        Record(
            row=name,
            quantity="free run [samples/s], median",
            thesis=None,
            here=rate[name],
            bound="" if name != "slipangle" else ">= 20 times the NumPy loop",
            holds=name != "slipangle" or rate[name] >= 20 * rate["NumPy loop"],
            note=f"p99 {late[name]:.3g} samples/s",
        )
        for name in peers
    ]
    records.append(
        Record(
            row="slipangle and NumPy loop",
            quantity="largest difference [rad/s]",
            thesis=None,
            here=agree,
            bound="<= 1e-10",
            holds=agree <= 1e-10,
        )
    )
    return Reproduction(
        title="Free run of the bicycle, 5 Runge-Kutta steps per sample",
        records=tuple(records),
        protocol=f"{SAMPLES} samples (peers {n}), process time, one thread, in turn.",
    )
